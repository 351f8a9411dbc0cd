"""Sizes at which candidates are linearised, by visibility in noise units; bank settings."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from loose_env.gap.experiment_design.candidates import Ray
from loose_env.gap.experiment_design.motions import Motion
from loose_env.gap.experiment_design.servo_arm import ServoArm
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.io import written_beside
from loose_env.typing import Array

STEP = 0.3
"""Step of a derivative by a nominal parameter over the tolerance, and by a shape parameter over its
standard deviation."""
_SEARCHES = 4
"""Steps of the search for the size of the least visibility."""
_RATIO = 3.0
"""Largest ratio of neighbouring sizes of effects that have a smallest one."""
_TOGETHER = 60
"""Hypotheses simulated at a time."""

Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class BankSettings:
    """Settings of a bank of signatures.

    Visibility is the length of an effect's signature on the fixed battery that no change of the
    nominal parameters explains [noise standard deviations].
    """

    kinds: tuple[str, ...] | None = None
    """Kinds of effect; by default the catalogue but for `EXCLUDED`."""
    visibility: tuple[float, float] = (6.0, 160.0)
    """Smallest and largest visibility of the linearisation points [noise standard deviations]."""
    points: int = 4
    """Linearisation points of a ray, in equal ratios of visibility."""
    curved_points: int = 8
    """Points of the rays of springs and times, which are far from linear, in equal ratios of
    size."""
    rank: int = 112
    """Directions that are kept of each motion."""


@dataclass(frozen=True, eq=False)
class SizedRays:
    """Rays with the sizes at which they are linearised."""

    rays: tuple[Ray, ...]
    sizes: tuple[Array, ...]
    """Sizes of each ray's points."""
    visibilities: tuple[Array, ...]
    """Visibilities there [noise standard deviations]."""

    def only(self, kept: Sequence[int]) -> SizedRays:
        """Those of some indices."""
        return SizedRays(
            tuple(self.rays[k] for k in kept),
            tuple(self.sizes[k] for k in kept),
            tuple(self.visibilities[k] for k in kept),
        )

    def write(self, path: Path) -> None:
        """Write them to an .npz file."""

        def stored(beside: Path) -> None:
            with beside.open("wb") as out:
                np.savez(
                    out,
                    rays=np.array([_key(ray) for ray in self.rays]),
                    points=np.array([len(own) for own in self.sizes]),
                    sizes=np.concatenate(self.sizes),
                    visibilities=np.concatenate(self.visibilities),
                )

        written_beside(path, stored)

    @classmethod
    def read(cls, path: Path, rays: Sequence[Ray]) -> SizedRays | None:
        """Stored ones among some rays; None where there are none, or none that can be read."""
        every = {_key(ray): ray for ray in rays}
        try:
            with path.open("rb") as opened, np.load(opened, allow_pickle=False) as stored:
                ends = np.cumsum(stored["points"])[:-1]
                sizes, seen = (np.split(stored[k], ends) for k in ("sizes", "visibilities"))
                shown = tuple(every[str(key)] for key in stored["rays"])
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):
            return None
        return cls(shown, tuple(sizes), tuple(seen))


def _key(ray: Ray) -> str:
    return json.dumps([ray.name, ray.effect.variant, *np.round(ray.start, 9).tolist()])


def residuals(arm: ServoArm, commands: Array, hypotheses: Sequence[Hypothesis]) -> list[Array]:
    """Readings in noise standard deviations, flat (n C,), of hypotheses in small batches."""
    found = []
    for begin in range(0, len(hypotheses), _TOGETHER):
        group = hypotheses[begin : begin + _TOGETHER]
        found += [(r / arm.noise).ravel() for r in arm.simulate(group, commands)]
    return found


def nuisance_columns(arm: ServoArm, commands: Array, base: Array) -> Array:
    """Change of the readings with one prior standard deviation of each nominal parameter (N, P)."""
    nominal, steps = arm.nominal, []
    count = len(nominal.entries)
    for k in range(count):
        factors = np.ones(count)
        factors[k] += STEP * arm.tolerance
        steps.append(Hypothesis(nominal=nominal, factors=factors))
    sds = np.array([p.spread or 1.0 for p in nominal.parameters])
    moved = np.array(residuals(arm, commands, steps))
    return np.asarray((moved - base).T / STEP * sds)


def sized_rays(
    arm: ServoArm,
    rays: Sequence[Ray],
    reference: Sequence[Motion],
    settings: BankSettings,
    say: Say,
) -> SizedRays:
    """Rays that can be seen, with the sizes of their points and visibilities there."""
    motions = [motion.commands(arm) for motion in reference]
    bases = [residuals(arm, commands, [Hypothesis()])[0] for commands in motions]
    columns = [nuisance_columns(arm, c, b) for c, b in zip(motions, bases, strict=True)]
    across = sum((c.T @ c for c in columns), np.eye(columns[0].shape[1]))

    def visibility(sizes: Array, of: Sequence[Ray] = rays) -> Array:
        total, inside = np.zeros(len(of)), np.zeros((len(of), len(across)))
        tried = [r.hypothesis(r.values(float(s))) for r, s in zip(of, sizes, strict=True)]
        for commands, base, column in zip(motions, bases, columns, strict=True):
            change = np.array(residuals(arm, commands, tried)) - base
            total += np.sum(change**2, axis=1)
            inside += change @ column
        explained = np.sum(inside * np.linalg.solve(across, inside.T).T, axis=1)
        return np.asarray(np.sqrt(np.maximum(total - explained, 0.0)))

    most = np.array([0.95 * ray.largest for ray in rays])
    least = np.array([max(ray.smallest, 1e-9) for ray in rays])
    steps = np.geomspace(*settings.visibility, settings.points) / settings.visibility[0]
    sizes, seen = np.empty((2, len(rays), settings.points))
    tried: list[tuple[Array, Array]] = []
    target = np.full(len(rays), settings.visibility[0])
    size = np.clip(np.array([1.0 if r.smallest == 0 else r.smallest for r in rays]), least, most)
    most_here = most
    for k, step in enumerate(steps):
        wanted = target * step if k else target
        if k:
            size = np.clip(sizes[:, k - 1] * steps[k] / steps[k - 1], least, most)
            # springs and times are far from linear: their points lie close together
            reach = np.where(least > 1e-9, _RATIO * sizes[:, k - 1], np.inf)
            most_here = np.minimum(most, reach)
            size = np.minimum(size, most_here)
        for number in range(_SEARCHES if k == 0 else 2):
            say(f"sizes of the effects: point {k + 1} of {settings.points}, step {number + 1}")
            found = np.where(np.isfinite(v := visibility(size)), v, np.inf)
            tried.append((size, found))
            size = np.clip(_next_size(tried, wanted), least, most_here)
        off = np.array([np.abs(np.log(np.maximum(f, 1e-9) / wanted)) for _, f in tried])
        if k:  # larger than the point before
            tries = np.array([s for s, _ in tried])
            off[(tries <= 1.2 * sizes[:, k - 1]) | (tries > 1.001 * most_here)] = np.inf
        pick = np.argmin(np.where(np.isfinite(off), off, 1e9), axis=0)
        every = np.array([s for s, _ in tried]), np.array([f for _, f in tried])
        sizes[:, k], seen[:, k] = (values[pick, np.arange(len(rays))] for values in every)
        if k == 0:  # what is seen clearly at its least size begins there
            target = np.maximum(target, seen[:, 0])
    # a ray that reaches less than twice the least visibility within its bounds is not seen
    keep = np.flatnonzero(
        (seen[:, -1] > 2 * settings.visibility[0]) & (np.diff(sizes, axis=1) > 0).all(axis=1)
    )
    shown = [rays[int(k)] for k in keep]
    own, their = list(sizes[keep]), list(seen[keep])
    curved = [k for k, ray in enumerate(shown) if ray.smallest > 0]
    finer = [np.geomspace(own[k][0], own[k][-1], settings.curved_points) for k in curved]
    if curved:
        say(f"sizes of the effects: {settings.curved_points} points of springs and times")
        found = np.array([visibility(s, [shown[k] for k in curved]) for s in np.array(finer).T])
        for k, ends, values in zip(curved, finer, found.T, strict=True):
            own[k], their[k] = ends, np.nan_to_num(values)
    return SizedRays(tuple(shown), tuple(own), tuple(their))


def _next_size(tried: Sequence[tuple[Array, Array]], target: Array) -> Array:
    """Next size of each ray: between the nearest below and above the target, else in proportion."""
    sizes = np.array([s for s, _ in tried])
    seen = np.array([v for _, v in tried])
    below = np.where(seen < target, sizes, -np.inf).max(axis=0)
    above = np.where(seen >= target, sizes, np.inf).min(axis=0)
    v_below = np.where(sizes == below, seen, 0.0).max(axis=0)
    v_above = np.where(sizes == above, seen, np.inf).min(axis=0)
    found = np.empty(len(below))
    for k in range(len(found)):
        if np.isfinite(below[k]) and np.isfinite(above[k]) and below[k] < above[k]:
            low, high = np.log(max(v_below[k], 1e-3)), np.log(min(v_above[k], 1e6))
            share = np.clip((np.log(target[k]) - low) / max(high - low, 1e-9), 0.1, 0.9)
            found[k] = below[k] * (above[k] / below[k]) ** share
        elif np.isfinite(above[k]):
            found[k] = above[k] * np.clip(target[k] / min(v_above[k], 1e9), 0.01, 0.9)
        else:
            found[k] = below[k] * np.clip(target[k] / max(v_below[k], 1e-9), 1.1, 20.0)
    return found
