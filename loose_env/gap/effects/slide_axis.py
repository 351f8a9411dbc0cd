"""The direction in which a link would have to slide to shake the tool as it was shaken.

What a slide does to the tool is known from the model: the tool goes with the link, and the joints,
which no drive holds at the frequencies of an impact, give way by their inertia. Seen through that,
in the link that slides the shaking has one axis in all poses, and in other links it spreads. So was
the loose link found in the thesis (4.2.2), there with joints that stand still.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from loose_env.gap.accelerations import ResidualAccelerations

__all__ = ["Slides", "slide_axis"]

Array = NDArray[np.float64]

_SLIGHT = 1e-3
"""Share of the largest response that a direction has to show to be told at all."""


@dataclass(frozen=True, eq=False)
class Slides:
    """An arm of which one link can slide along three axes."""

    model: mujoco.MjModel
    """The arm, slides included."""
    names: tuple[str, ...]
    """Joints of the slides, along the link's x, y, z."""

    @cached_property
    def added(self) -> list[int]:
        """Their places among the degrees of freedom."""
        return [int(self.model.joint(name).dofadr[0]) for name in self.names]

    @cached_property
    def own(self) -> list[int]:
        """Those of all other joints."""
        return [k for k in range(self.model.nv) if k not in self.added]

    def mass(self, data: mujoco.MjData) -> Array:
        """Mass matrix (nv, nv) in a pose that was evaluated."""
        found = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, data, found)
        return found

    def response(self, data: mujoco.MjData, site: int) -> Array:
        """Acceleration of a site in its own frame (3, 3) per acceleration of each slide."""
        mass = self.mass(data)
        moved = np.zeros((self.model.nv, 3))
        moved[self.added] = np.eye(3)
        moved[self.own] = -np.linalg.solve(
            mass[np.ix_(self.own, self.own)], mass[np.ix_(self.own, self.added)]
        )
        jacobian = np.zeros((3, self.model.nv))
        mujoco.mj_jacSite(self.model, data, jacobian, None, site)
        return np.asarray(data.site_xmat[site].reshape(3, 3).T @ jacobian @ moved)


def slide_axis(slides: Slides, residual: ResidualAccelerations) -> Array | None:
    """Direction of the slide that explains most of a shaking.

    Largest ratio of what goes along the slide's response to all that it could be, sample by
    sample: a generalised problem of eigenvalues.

    Parameters
    ----------
    slides : Slides
        The arm.
    residual : ResidualAccelerations
        What was measured beyond the model.

    Returns
    -------
    ndarray (3,) or None
        Unit vector in the frame of the link; None where no slide would be seen.
    """
    model = slides.model
    data = mujoco.MjData(model)
    places = [int(model.joint(name).qposadr[0]) for name in residual.joints]
    along, size = np.zeros((3, 3)), np.zeros((3, 3))
    for pose, name, shaken in zip(
        residual.poses, residual.sites, residual.accelerations, strict=True
    ):
        data.qpos[:] = model.qpos0
        data.qpos[places] = pose
        mujoco.mj_fwdPosition(model, data)
        response = slides.response(data, model.site(name).id)
        seen = response.T @ shaken
        along += np.outer(seen, seen)
        size += float(shaken @ shaken) * response.T @ response
    largest = float(np.linalg.eigvalsh(size)[-1])
    if not np.isfinite(largest) or largest <= 0:
        return None
    _, axes = eigh(along, size + _SLIGHT * largest * np.eye(3))
    return np.asarray(axes[:, -1] / np.linalg.norm(axes[:, -1]))
