"""The observation of a robot without accelerometers: drive torque and encoder alone (2.2.2).

That a seat is loose shows there nearly as well as at the tool; its direction does not.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from loose_env.envs.diagnosis_env import DiagnosisEnv
from loose_env.errors import InvalidSetting

__all__ = ["JointSideObservation"]

_GROUPS = ("level", "torque", "level_share", "duration", "joint_rms", "inertia", "valid")
"""Groups of a record that torque, encoder and the excitation give, beside its pose."""


class JointSideObservation(gymnasium.ObservationWrapper[Any, Any, Any]):
    """Keeps of the observation what torque and encoders give.

    Left are the pose, what has been spent, and of every record its pose, excitation, joint
    motion and apparent inertia, measured and nominal.

    Parameters
    ----------
    env : gymnasium.Env
        A diagnosis environment with the flat observation.

    Raises
    ------
    InvalidSetting
        If it is no diagnosis environment, or ``raw`` is set.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = gymnasium.make("loose_env/Planar-v0", n_links=2)
    >>> whole, alone = env.observation_space.shape[0], JointSideObservation(env)
    >>> alone.observation_space.shape[0] < whole / 2, "record1.inertia.joint1" in alone.names
    (True, True)
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        inner = env.unwrapped
        if not isinstance(inner, DiagnosisEnv):
            raise InvalidSetting(f"{type(inner).__name__} is no diagnosis environment")
        space = env.observation_space
        if not isinstance(space, spaces.Box):
            raise InvalidSetting(
                "the joint-side observation is a part of the flat one; set raw=False, or read "
                "command and encoder from the raw signals"
            )
        elements = inner.layout.elements
        kept = [k for k, element in enumerate(elements) if _of_joints(element.name)]
        self._kept = np.array(kept)
        self.names = tuple(elements[k].name for k in kept)
        """Names of the elements that are left, in order."""
        self.observation_space = spaces.Box(space.low[kept], space.high[kept], dtype=np.float32)

    def observation(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Take the elements that are left."""
        return np.asarray(observation[self._kept])


def _of_joints(name: str) -> bool:
    record, _, rest = name.partition(".")
    if not record.startswith("record"):
        return True
    group = rest.partition(".")[0].removeprefix("nominal_")
    return group in _GROUPS or group.endswith("pose")
