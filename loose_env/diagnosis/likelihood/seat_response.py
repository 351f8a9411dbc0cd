"""Response of the linear arm with one seat freed, for every seat.

A shut seat transmits a force. If it floats, the two sides part with acceleration
``-force / apparent mass``, and the whole arm answers through the seat's open columns. A seat
that opens in part moves ``s`` times as far, in step with the force; what it does out of step
(impacts, stick and slip) adds motion along the same direction that follows no command.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import LinearPose
from loose_env.typing import Array, ComplexArray

__all__ = ["SeatPrediction", "predict_seats"]

_CHUNK = 400_000
"""Complex numbers worked on at once: what the processor's cache holds, and little memory."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SeatPrediction:
    """Answers of the m excited joints and the d tool axes, p = m + d channels.

    Places are the sliding directions of link 1, those of link 2, ..., then the joints' plays:
    P = n A + n of them. The command of each excited joint has its rms.
    """

    in_step: Array
    """Healthy part of the answer in step with the command (p, m), per unit-rms command."""
    in_step_open: Array
    """Change of it if a seat floats (P, p, m)."""
    rest: Array
    """Covariance of the healthy answer's part out of step with the command (p, p)."""
    rest_mixed: Array
    """Term of that covariance in s if a seat opens (P, p, p)."""
    rest_open: Array
    """Term of it in s² (P, p, p)."""
    loose: Array
    """Covariance that the free motion of a seat on its own would add (P, p, p)."""
    force: Array
    """Rms force or torque that the shut seat transmits (P,)."""
    load: Array
    """Force or torque that gravity puts on the seat at rest, without sign (P,)."""


def predict_seats(
    pose: LinearPose,
    torque: Array,
    directions: Array,
    floor: Array,
    *,
    locations: NDArray[np.intp] | None = None,
    covariances: bool = True,
) -> SeatPrediction:
    """Work out all seats of the arm in one pose.

    Parameters
    ----------
    pose : LinearPose
        The nominal arm at the pose.
    torque : ndarray (n,)
        Rms torque of every joint [N·m]; zero for held joints. At least one must be on.
    directions : ndarray (A, axes)
        Sliding directions of a link, unit vectors in its frame.
    floor : ndarray (p,)
        Variance that the sensors add to each channel.
    locations : ndarray of int, optional
        Places that are asked for, in the order in which they are wanted; all by default.
    covariances : bool
        False to leave out what is out of step and the free motion of the seats, which takes most
        of the time: `rest_mixed`, `rest_open` and `loose` then have no places.

    Examples
    --------
    >>> import numpy as np
    >>> from loose_env.arms import planar
    >>> from loose_env.arms import LinearArm
    >>> at = LinearArm(planar(2)).at([0.0, 1.0])
    >>> seats = predict_seats(at, np.array([0.0, 3.0]), np.eye(2), np.zeros(3))
    >>> seats.in_step_open.shape
    (6, 3, 1)
    """
    excited = torque > 0
    on = np.flatnonzero(excited)
    answer, opened = pose.response(excited), pose.open_response(excited)
    t = torque[on]
    n, count = pose.linear.arm.n, len(answer.frequency)
    slides = n * len(directions)
    asked = np.arange(slides + n) if locations is None else np.asarray(locations)
    of_slide = asked < slides
    link, u = asked[of_slide] // len(directions), directions[asked[of_slide] % len(directions)]
    joint = asked[~of_slide] - slides

    def placed(of_slides: ComplexArray, of_hinges: ComplexArray) -> ComplexArray:
        """Put slides and hinges where they were asked for, along the second axis."""
        both = np.empty((count, len(asked), *of_slides.shape[2:]), dtype=complex)
        both[:, of_slide], both[:, ~of_slide] = of_slides, of_hinges
        return both

    healthy = np.concatenate([answer.joint[:, on], answer.tool], axis=1) * t
    force = placed(np.einsum("kpsm,ps->kpm", answer.slide[:, link], u), answer.hinge[:, joint]) * t
    mass = placed(
        np.einsum("kpsr,ps,pr->kp", opened.mass_slide[:, link], u, u),
        opened.inertia_hinge[:, joint],
    )
    slide = np.concatenate([opened.joint_open_slide, opened.tool_open_slide], axis=1)
    hinge = np.concatenate([opened.joint_open_hinge, opened.tool_open_hinge], axis=1)
    column = placed(
        np.einsum("kcps,ps->kpc", slide[:, :, link], u), hinge[:, :, joint].transpose(0, 2, 1)
    )
    free = -force / mass[..., None]

    # Averages over the band, locations first so that each is one small matrix product.
    column, free = column.transpose(1, 2, 0), free.transpose(1, 2, 0)
    in_step = healthy.real.mean(0)
    own = healthy.transpose(1, 2, 0).reshape(len(in_step), -1)
    p, m = len(in_step), len(on)
    in_step_open = np.empty((len(free), p, m))
    asked_for = len(free) if covariances else 0
    mixed, rest_open, loose = (np.empty((asked_for, p, p)) for _ in range(3))
    if not covariances:
        in_step_open = (column @ free.transpose(0, 2, 1)).real / count
    chunk = max(1, _CHUNK // (p * m * count))
    for some in (slice(k, k + chunk) for k in range(0, asked_for, chunk)):
        change = column[some, :, None] * free[some, None]  # (chunk, p, m, K)
        step = change.real.mean(-1)
        flat = change.reshape(*change.shape[:2], -1)
        across = (own @ flat.conj().transpose(0, 2, 1)).real / count
        in_step_open[some] = step
        mixed[some] = across - in_step @ step.transpose(0, 2, 1)
        rest_open[some] = (flat @ flat.conj().transpose(0, 2, 1)).real / count
        rest_open[some] -= step @ step.transpose(0, 2, 1)
        loose[some] = (column[some] @ column[some].conj().transpose(0, 2, 1)).real / count
    power = np.mean(np.sum(np.abs(free) ** 2, axis=1), axis=-1)
    at_rest = [(pose.seat_load @ directions.T).ravel(), pose.load[pose.linear.hinge_dofs]]
    return SeatPrediction(
        in_step=in_step,
        in_step_open=in_step_open,
        rest=(own @ own.conj().T).real / count - in_step @ in_step.T + np.diag(floor),
        rest_mixed=mixed + mixed.transpose(0, 2, 1),
        rest_open=rest_open,
        loose=loose * power[:asked_for, None, None],
        force=np.sqrt(np.mean(np.sum(np.abs(force) ** 2, axis=-1), axis=0)),
        load=np.abs(np.concatenate(at_rest))[asked],
    )
