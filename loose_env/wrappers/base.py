"""Base of the wrappers: what is inside, and what stays the same through all of them."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from loose_env.envs import DiagnosisEnv
from loose_env.errors import InvalidSetting

__all__ = ["DiagnosisWrapper"]


class DiagnosisWrapper(
    gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs
):
    """A Gymnasium wrapper around a single diagnosis environment, or a wrapped one.

    Parameters
    ----------
    env : gymnasium.Env
        The environment.
    **arguments
        Arguments of the subclass, from which Gymnasium makes the wrapper anew.

    Raises
    ------
    InvalidSetting
        If it is no diagnosis environment, or shows raw signals.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], **arguments: Any) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self, **arguments)
        gymnasium.Wrapper.__init__(self, env)
        inner = env.unwrapped
        if not isinstance(inner, DiagnosisEnv):
            raise InvalidSetting(
                f"{type(self).__name__} wraps a single diagnosis environment, as gymnasium.make "
                f"gives it; got {type(inner).__name__}. For several, give wrappers=[...] and "
                "vectorization_mode='sync' to gymnasium.make_vec"
            )
        if inner.settings.raw:
            raise InvalidSetting(
                f"{type(self).__name__} takes the flat observation: make the environment without "
                "raw=True"
            )
        self.diagnosis = inner
        """The environment within all wrappers."""

    def inner_masks(self) -> NDArray[np.bool_]:
        """Allowed choices of the environment that is wrapped."""
        masks: NDArray[np.bool_] = self.env.get_wrapper_attr("action_masks")()
        return masks

    def action_masks(self) -> NDArray[np.bool_]:
        """Allowed choices of the next action, in the form MaskablePPO takes."""
        return self.inner_masks()

    def masked(self, info: dict[str, Any]) -> dict[str, Any]:
        """Info with the mask of this wrapper's own actions."""
        return {**info, "action_mask": self.action_masks()}
