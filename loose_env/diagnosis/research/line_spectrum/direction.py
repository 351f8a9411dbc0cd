"""Open seat and its sliding direction, from the whole dynamic model.

Where gears or servos are compliant in the band, the other joints move with the loose seat, and the
change of transmission no longer points along the slide. The linear arm still says how: a seat at
link k that accelerates by s along u, a unit vector in the frame of link k, adds C_k(f) u s(f) to
the readings at frequency f. Direction u is the same at all frequencies, in all records and poses;
s is an unknown of its own for every line of every record, so gap, friction and stops need no model.
Eliminating s leaves a misfit of every u at every link, and of play in every joint. Its lowest
point is the estimate, and its lowest values tell the locations apart, in one pose as in several.

A healthy arm's part of the readings is taken off line by line, by healthy records in the same
pose, or by the model. In both cases the model's errors are estimated first: from the healthy
records, or from the records under test together with the seat.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import LinearArm, Mismatch
from loose_env.diagnosis.link_finding.direction_images import ToolFrames, fault_locations
from loose_env.diagnosis.research.line_spectrum.model_error_fit import (
    answers_of,
    fit_errors,
    healthy_misfit,
    misfit_along,
)
from loose_env.diagnosis.research.line_spectrum.record_lines import (
    RecordLines,
    less_healthy,
    record_lines,
)
from loose_env.diagnosis.research.line_spectrum.uncertain_arm import Answer, UncertainArm
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.rig import Measurement
from loose_env.sensors import SensorSuite
from loose_env.statistics import axes_grid, tangents
from loose_env.typing import Array

__all__ = ["DynamicDirection", "direction_by_dynamics"]


_GRID = {1: 1, 2: 90, 3: 400}
"""Axes at which the misfit is looked at first, by the axes of a seat."""
_FIRST_STEP, _LAST_STEP = 0.1, 1e-4  # of the search about the best of them [rad]
_AROUND = 8
_COARSE = (0.3, 0.2, 0.1, 0.05)
"""Model errors allowed at first where no healthy record fixes the resonances. A line counts
little while the model may put its resonance elsewhere."""
_COARSE_STEPS, _STEPS = 3, 8
_FITTED = 3
"""Best locations for which the model's errors are fitted once more, each on its own."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DynamicDirection:
    """Location and direction of a loose seat, of the lowest misfit."""

    location: str
    """Name of the location, one of `loose_env.diagnosis.fault_locations`."""
    direction_in_link: Array | None
    """Unit vector in the frame of the loose link (d,); None for play in a joint."""
    direction_in_tool: Array
    """The same in the tool frame, in the pose of the first record (d,)."""
    locations: tuple[str, ...]
    """Locations that were compared."""
    misfits: Array
    """Lowest misfit of each, twice a negative log-likelihood but for a constant. Half a difference
    of two is a log-likelihood ratio, if the model is right (locations,)."""
    directions: tuple[Array | None, ...]
    """Best direction of each location, in the frame of its link; None for play in a joint."""
    healthy_misfit: float
    """Misfit with no seat open."""
    lines: int
    """Fourier lines of all records."""
    values: int
    """Complex readings of all of them that are left to test the model, the seat's motion fitted."""
    errors: Array
    """Estimated errors of the model, in standard deviations of the mismatch (P,)."""
    error_names: tuple[str, ...]
    """Parameter of each error."""

    @property
    def evidence(self) -> float:
        """Fall of the misfit by the best seat, less what it takes of mere noise.

        A seat's motion fits one complex number to every line, which takes 2 from the misfit of
        each. Around zero or below no seat is seen to move, and the direction means nothing.
        """
        return self.healthy_misfit - float(self.misfits.min()) - 2.0 * self.lines

    @property
    def lack_of_fit(self) -> float:
        """Lowest misfit over what noise and the model error that was allowed explain [1].

        Around one or below where model and seat explain the records. Far above, the model lacks
        something, such as compliant gears, or more than one seat is open: then the location and
        the direction are not to be trusted, however strong the evidence that something moves.
        """
        return float(self.misfits.min()) / (2.0 * self.values)


def direction_by_dynamics(
    linear: LinearArm,
    records: Sequence[Measurement],
    *,
    healthy: Sequence[Measurement] | None = None,
    link: int | None = None,
    mismatch: Mismatch | None = None,
    sensors: SensorSuite | None = None,
    model_error: float = 0.02,
) -> DynamicDirection:
    """Find the open seat and its direction with the dynamic model of the arm.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm with what holds its joints.
    records : sequence of Measurement
        Records of the arm under test, in one pose or in several. Every joint in turn is best: a
        seat that no excitation moves is not seen.
    healthy : sequence of Measurement, optional
        Records of the same arm when it was healthy, of the same length: for every record as many
        with the same joints excited in the same pose as it excites joints. Without them the
        model says what a healthy arm would show.
    link : int, optional
        Loose link, from 1 at the base, where it is known; else all links' slides and all joints'
        play are compared.
    mismatch : Mismatch, optional
        Errors of the model; the defaults of `Mismatch`.
    sensors : SensorSuite, optional
        Sensors of the records, for their noise; the defaults of `SensorSuite`.
    model_error : float
        Remaining model error at each line, relative to the motion there [1].

    Returns
    -------
    DynamicDirection

    Raises
    ------
    InvalidData
        If there is no record, one cannot be used, or healthy records are missing.
    InvalidSetting
        If the arm has no such link or the model error is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> from loose_env.arms import planar, with_compliance
    >>> from loose_env.excitation import Excitation
    >>> from loose_env.faults import StructuralLooseness
    >>> from loose_env.rig import SimulatedRig
    >>> arm = with_compliance(planar(2), mode_hz=70.0)
    >>> rig, pose = SimulatedRig(arm), np.array([0.1, 1.2])
    >>> shakes = [
    ...     Excitation(torque_rms=t, duration=0.6, band=arm.band) for t in ((9.0, 0.0), (0.0, 4.0))
    ... ]
    >>> references = [rig.measure(pose, shake) for shake in shakes]
    >>> slide = StructuralLooseness(
    ...     link=1, direction=(0.6, 0.8, 0.0), gap=2e-4, stiffness=(2e5, 2e5), damping=(50.0, 50.0)
    ... )
    >>> rig.mount(0, slide)
    >>> loose = [rig.measure(pose, shake, rng=np.random.default_rng(1)) for shake in shakes]
    >>> found = direction_by_dynamics(LinearArm(arm), loose, healthy=references)
    >>> found.location, found.direction_in_link.round(1).tolist()
    ('structural_looseness@link1', [0.6, 0.8])
    """
    if not records:
        raise InvalidData("no record is given; excite every joint in turn, in one pose or several")
    if not np.isfinite(model_error) or model_error <= 0:
        raise InvalidSetting(f"model_error is relative and positive, got {model_error!r}")
    number = None if link is None else linear.arm.link_number(link)
    suite = SensorSuite() if sensors is None else sensors
    arm = UncertainArm(linear, Mismatch() if mismatch is None else mismatch)
    lines = [record_lines(linear.arm, record, suite) for record in records]
    seats = _seats(linear, number)
    if healthy is None:
        found = _with_the_seat(arm, lines, seats, model_error)
    else:
        references = [record_lines(linear.arm, record, suite) for record in healthy]
        lines = [less_healthy(one, references) for one in lines]
        errors = fit_errors(arm, references, model_error=model_error, steps=_STEPS).errors
        answers = answers_of(arm, lines, errors)
        found = _Found(
            errors=errors,
            seats={name: _best_axis(lines, answers, at, model_error) for name, at in seats.items()},
            healthy=healthy_misfit(lines, answers, model_error),
        )
    names = tuple(seats)
    best = min(names, key=lambda name: found.seats[name][0])
    slides = {name: len(columns) > 1 for name, columns in seats.items()}
    directions = {n: found.seats[n][1] if slides[n] else None for n in names}
    return DynamicDirection(
        location=best,
        direction_in_link=directions[best],
        direction_in_tool=_seen(linear, records[0].pose, best, found.seats[best][1]),
        locations=names,
        misfits=np.array([found.seats[name][0] for name in names]),
        directions=tuple(directions.values()),
        healthy_misfit=found.healthy,
        lines=sum(len(one.frequency) for one in lines),
        values=sum(one.readings.size - len(one.frequency) for one in lines),
        errors=found.errors,
        error_names=arm.names,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Found:
    errors: Array
    seats: dict[str, tuple[float, Array]]
    """Misfit and axis of each location."""
    healthy: float


def _seats(linear: LinearArm, link: int | None) -> dict[str, NDArray[np.intp]]:
    """Columns of each location among those of an `Answer`."""
    n, axes = linear.slide_dofs.shape
    columns = [np.arange(k * axes, (k + 1) * axes, dtype=np.intp) for k in range(n)]
    columns += [np.array([n * axes + k], dtype=np.intp) for k in range(n)]
    named = dict(zip(fault_locations(linear.arm), columns, strict=True))
    if link is None:
        return named
    name = fault_locations(linear.arm)[link - 1]
    return {name: named[name]}


def _with_the_seat(
    arm: UncertainArm,
    lines: Sequence[RecordLines],
    seats: dict[str, NDArray[np.intp]],
    model_error: float,
) -> _Found:
    """Estimate the model's errors and the seat from the same records.

    The errors are common to all locations at first, and the location is chosen anew at each step,
    while the allowed model error comes down. Then they are fitted for the best few apart.
    """
    errors = np.zeros(len(arm.names))
    for allowed in (*(e for e in _COARSE if e > model_error), model_error):
        answers = answers_of(arm, lines, errors)
        looks = {n: _best_axis(lines, answers, at, allowed) for n, at in seats.items()}
        best = min(looks, key=lambda name: looks[name][0])
        errors = fit_errors(
            arm,
            lines,
            model_error=allowed,
            columns=seats[best],
            seat=looks[best][1],
            errors=errors,
            steps=_COARSE_STEPS,
        ).errors
    answers = answers_of(arm, lines, errors)
    known = float(errors @ errors)
    found = {}
    for name, at in seats.items():
        misfit, axis = _best_axis(lines, answers, at, model_error)
        found[name] = misfit + known, axis
    common, chosen = errors, np.inf
    for name in sorted(found, key=lambda name: found[name][0])[:_FITTED]:
        fit = fit_errors(
            arm,
            lines,
            model_error=model_error,
            columns=seats[name],
            seat=found[name][1],
            errors=common,
            steps=_STEPS,
        )
        assert fit.seat is not None
        found[name] = fit.cost, fit.seat
        if fit.cost < chosen:
            errors, chosen = fit.errors, fit.cost
    intact = min(
        fit_errors(arm, lines, model_error=model_error, errors=start, steps=_STEPS).cost
        for start in (common, np.zeros(len(arm.names)))
    )
    return _Found(errors=errors, seats=found, healthy=intact)


def _best_axis(
    lines: Sequence[RecordLines],
    answers: Sequence[Answer],
    columns: NDArray[np.intp],
    model_error: float,
) -> tuple[float, Array]:
    """Lowest misfit of a seat, and the axis where it lies."""

    def misfit(axes: Array) -> Array:
        return misfit_along(lines, answers, columns, axes, model_error)

    size = len(columns)
    grid = axes_grid(_GRID[size], size) if size > 1 else np.ones((1, 1))
    values = misfit(grid)
    best = int(np.argmin(values))
    return _refined(misfit, grid[best], float(values[best]))


def _refined(misfit: Callable[[Array], Array], axis: Array, value: float) -> tuple[float, Array]:
    """Go downhill from an axis on ever smaller rings about it."""
    step = _FIRST_STEP if len(axis) > 1 else 0.0
    turn = 2 * np.pi * np.arange(_AROUND) / _AROUND
    round_about = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    while step > _LAST_STEP:
        across = np.array([[1.0], [-1.0]]) if len(axis) == 2 else round_about
        ring = np.cos(step) * axis + np.sin(step) * across @ tangents(axis)
        values = misfit(ring)
        lowest = int(np.argmin(values))
        if values[lowest] < value:
            axis, value = ring[lowest], float(values[lowest])
        else:
            step /= 2
    return value, axis


def _seen(linear: LinearArm, pose: Array, location: str, axis: Array) -> Array:
    """Direction of a seat in the tool frame, unit vector (d,)."""
    frames = ToolFrames(linear.arm)
    at = fault_locations(linear.arm).index(location)
    if at < linear.arm.n:
        return np.asarray(frames.images(pose)[0, at] @ axis)
    return np.asarray(frames.unit_lines(pose)[0, at - linear.arm.n])
