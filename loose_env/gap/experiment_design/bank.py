"""Bank of signatures: change of readings by every candidate on every library motion, cached.

For each motion the bank holds the readings of the nominal model, their derivatives by the nominal
parameters, and their change with each candidate effect at several sizes and with its shape. All are
in noise standard deviations and projected onto the few directions that they span together, which
lose nothing to a model that is linear in them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.gap.experiment_design.candidates import Ray, rays_of
from loose_env.gap.experiment_design.motions import Motion, battery, check_motion
from loose_env.gap.experiment_design.servo_arm import ServoArm
from loose_env.gap.model.hypothesis import Hypothesis
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


def _sized(
    key: str,
    arm: ServoArm,
    rays: Sequence[Ray],
    reference: Sequence[Motion],
    settings: BankSettings,
    say: Say,
) -> tuple[list[int], list[Array], list[Array]]:
    """Indices of the rays that can be seen, the sizes of their points and visibilities there."""
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
    return [int(k) for k in keep], own, their


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


@dataclass(frozen=True, eq=False)
class MotionSignatures:
    """Signatures on one motion, in its own directions.

    V base vectors: the nominal parameters, the points of all rays, their shape derivatives.
    """

    basis: NDArray[np.float32]
    """Orthonormal directions (n C, K)."""
    nominal: NDArray[np.float32]
    """Readings of the nominal model (n, C) [rad, m, N·m, N]."""
    vectors: NDArray[np.float32]
    """Base vectors (K, V)."""
    seconds: float
    """Machine time [s]."""
    wear: float
    """Integral of the squared torque shares [s]."""

    def projected(self, readings: Array, noise: Array) -> tuple[Array, float]:
        """Residual of readings (n, C): its coordinates (K,) and the rms of the rest."""
        residual = ((readings - self.nominal) / noise).ravel()
        inside = self.basis.T @ residual
        rest = float(residual @ residual - inside @ inside)
        return np.asarray(inside), float(np.sqrt(max(rest, 0.0) / max(len(residual), 1)))


def _motion_signatures(
    key: str, arm: ServoArm, motion: Motion, sized: SizedRays, rank: int, say: Say, words: str
) -> MotionSignatures:
    """Simulate a motion with every candidate at every size, and project its signatures."""
    say(f"signatures, {words}: {motion.description}")
    checked, commands = check_motion(motion, arm), motion.commands(arm)
    rays, sizes = sized.rays, sized.sizes
    base = residuals(arm, commands, [Hypothesis()])[0]
    columns: list[NDArray[np.floating[Any]]] = [nuisance_columns(arm, commands, base)]
    points = [
        ray.hypothesis(ray.values(float(size)))
        for ray, own in zip(rays, sizes, strict=True)
        for size in own
    ]
    moved = np.array(residuals(arm, commands, points), dtype=np.float32)
    shaped, origins, begun = [], [], 0
    for ray, own in zip(rays, sizes, strict=True):
        middle = len(own) // 2
        for which in range(len(ray.shape_parameters)):
            off = np.zeros(len(ray.shape_parameters))
            off[which] = STEP
            shaped.append(ray.hypothesis(ray.values(float(own[middle]), off)))
            origins.append(begun + middle)
        begun += len(own)
    columns.append((moved - base).T)
    if shaped:
        there = np.array(residuals(arm, commands, shaped), dtype=np.float32)
        columns.append(((there - moved[origins]) / STEP).T)
    vectors = np.nan_to_num(np.concatenate(columns, axis=1)).astype(np.float32)
    vectors = np.clip(vectors, -1e5, 1e5)
    basis = _basis(vectors, rank)
    inside = basis.T @ vectors
    nominal = (base.reshape(-1, len(arm.channels)) * arm.noise).astype(np.float32)
    return MotionSignatures(
        basis, nominal, inside.astype(np.float32), checked.seconds,
        checked.wear,
    )  # fmt: skip


def _basis(vectors: NDArray[np.float32], rank: int) -> NDArray[np.float32]:
    """Orthonormal directions of base vectors, the large ones bounded in weight (N, K).

    A randomised range finder with one power iteration (Halko, Martinsson and Tropp, SIAM Review 53,
    2011, 217).
    """
    lengths = np.linalg.norm(vectors, axis=0)
    weighted = vectors / np.sqrt(np.maximum(lengths, 1.0))
    rng = np.random.default_rng(0)
    count = min(rank + 20, weighted.shape[0], weighted.shape[1])
    first = weighted @ rng.normal(size=(weighted.shape[1], count)).astype(np.float32)
    rough = np.linalg.qr(weighted @ (weighted.T @ np.linalg.qr(first)[0]))[0]
    left, _, _ = np.linalg.svd(rough.T @ weighted, full_matrices=False)
    return np.asarray((rough @ left)[:, :rank], dtype=np.float32)


_FORMAT = "gap signatures 4"
"""Version of what is stored; a change of the computation changes it."""
_CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "loose_env" / "gap"
"""Folder of stored banks."""

_INDISTINGUISHABLE_Z = 2.0
"""Length of a signature beside that of another candidate below which both are one candidate [noise
standard deviations]."""


@dataclass(frozen=True, eq=False)
class SignatureBank:
    """Candidates of an arm, a library of motions, and the signatures of ones on the others."""

    arm: ServoArm
    library: tuple[Motion, ...]
    settings: BankSettings
    sized: SizedRays
    """Rays that can be seen on the battery, with their sizes."""
    signatures: tuple[MotionSignatures, ...]
    """By motion."""

    @property
    def rays(self) -> tuple[Ray, ...]:
        """Rays that can be seen on the battery."""
        return self.sized.rays

    @property
    def sizes(self) -> tuple[Array, ...]:
        """Sizes of each ray's linearisation points."""
        return self.sized.sizes

    @property
    def visibilities(self) -> tuple[Array, ...]:
        """Visibilities there [noise standard deviations]."""
        return self.sized.visibilities

    @cached_property
    def seconds(self) -> Array:
        """Machine time of each motion [s] (M,)."""
        return np.array([found.seconds for found in self.signatures])

    @cached_property
    def wear(self) -> Array:
        """Integral of the squared torque shares of each motion [s] (M,)."""
        return np.array([found.wear for found in self.signatures])

    @cached_property
    def shape_columns(self) -> tuple[tuple[int, ...], ...]:
        """Base vectors of each ray's shape derivatives, at its middle point."""
        at, found = self.nuisances + sum(map(len, self.sizes)), []
        for ray in self.rays:
            count = len(ray.shape_parameters)
            found.append(tuple(range(at, at + count)))
            at += count
        return tuple(found)

    @property
    def names(self) -> tuple[str, ...]:
        """Candidates, kind and location, in the order of the rays."""
        return tuple(dict.fromkeys(ray.name for ray in self.rays))

    @property
    def nuisances(self) -> int:
        """Number of nominal parameters: the first base vectors."""
        return len(self.arm.nominal.entries)

    @cached_property
    def starts(self) -> NDArray[np.intp]:
        """Index of each ray's first point among those of all, and their number (R + 1,)."""
        return np.concatenate([[0], np.cumsum([len(own) for own in self.sizes])]).astype(np.intp)

    def point(self, ray: int, which: int | None = None) -> int:
        """Index of the base vector of a ray at one of its points; by default the middle one."""
        which = len(self.sizes[ray]) // 2 if which is None else which
        return self.nuisances + int(self.starts[ray]) + which

    def index_of(self, motion: Motion) -> int:
        """Index of a motion in the library.

        Raises
        ------
        InvalidData
            If it is not in it.
        """
        if motion not in self.library:
            raise InvalidData(f"{motion.description} is not in the library of this bank")
        return self.library.index(motion)


def signature_bank(
    arm: ServoArm,
    library: Sequence[Motion],
    settings: BankSettings | None = None,
    *,
    reference: Sequence[Motion] | None = None,
    cache: Path | None = _CACHE,
    say: Say | None = None,
) -> SignatureBank:
    """Read the bank of an arm and a library from the cache, or compute and store it.

    Parameters
    ----------
    arm : ServoArm
        The arm.
    library : sequence of Motion
        The motions.
    settings : BankSettings, optional
        Candidates and linearisation points.
    reference : sequence of Motion, optional
        Motions on which sizes are sought; the fixed battery by default.
    cache : Path, optional
        Folder of joblib's cache; None to store nothing. Each motion is an entry of its own: a
        computation that was cut short goes on, and a library may grow.
    say : callable, optional
        Receives lines of progress.
    """
    import joblib  # its start takes a quarter of a second

    settings, say = settings or BankSettings(), say or (lambda words: None)
    found, memory = rays_of(arm, settings.kinds), joblib.Memory(cache, verbose=0)
    stated = (asdict(settings), [(r.name, r.effect.variant, *r.start.tolist()) for r in found])
    on = battery(arm) if reference is None else tuple(reference)
    key = joblib.hash((_FORMAT, arm.key, stated, on)) or ""
    sizing = memory.cache(_sized, ignore=["arm", "rays", "reference", "settings", "say"])
    kept, *points = sizing(key, arm, found, on, settings, say)
    if not kept:
        raise InvalidData("no candidate effect can be seen on the battery of this arm")
    sized = SizedRays(tuple(found[k] for k in kept), *map(tuple, points))
    simulated = memory.cache(_motion_signatures, ignore=["arm", "sized", "rank", "say", "words"])
    signatures = tuple(
        simulated(key, arm, m, sized, settings.rank, say, f"motion {k} of {len(library)}")
        for k, m in enumerate(library, 1)
    )
    return _distinct(SignatureBank(arm, tuple(library), settings, sized, signatures))


def _distinct(bank: SignatureBank) -> SignatureBank:
    """The bank without candidates that no motion of it tells from an earlier one.

    All their signatures, less what nominal parameters explain, are multiples of one of the other's,
    as those of the mass of a link that only turns about the vertical and of its rotor's inertia.
    """
    p, middle = bank.nuisances, [bank.point(ray) for ray in range(len(bank.rays))]
    gram = np.zeros((p + len(middle),) * 2)
    for found in bank.signatures:
        vectors = found.vectors[:, [*range(p), *middle]].astype(float)
        gram += vectors.T @ vectors
    inside = np.linalg.solve(gram[:p, :p] + np.eye(p), gram[:p, p:])
    gram = gram[p:, p:] - gram[p:, :p] @ inside
    squares = np.diag(gram)
    left = squares[:, None] - gram**2 / np.maximum(squares, 1e-12)  # of each beside each other one
    dropped: set[str] = set()
    of = {name: [k for k, r in enumerate(bank.rays) if r.name == name] for name in bank.names}
    for number, name in enumerate(bank.names):
        for earlier in bank.names[:number]:
            own = left[np.ix_(of[name], of[earlier])].min(axis=1)
            if earlier not in dropped and np.all(own < _INDISTINGUISHABLE_Z**2):
                dropped.add(name)
    if not dropped:
        return bank
    kept = [k for k, ray in enumerate(bank.rays) if ray.name not in dropped]
    columns = list(range(p))
    for k in kept:
        columns += range(bank.point(k, 0), bank.point(k, 0) + len(bank.sizes[k]))
    columns += [column for k in kept for column in bank.shape_columns[k]]
    return replace(
        bank, sized=bank.sized.only(kept),
        signatures=tuple(replace(s, vectors=s.vectors[:, columns]) for s in bank.signatures),
    )  # fmt: skip
