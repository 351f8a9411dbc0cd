"""Bank of signatures: the readings of every motion under every candidate, computed once.

For each motion the bank holds the readings of the nominal model, their derivatives by the nominal
parameters, and their change with each candidate effect at several sizes and with its shape. All are
in noise standard deviations and projected onto the few directions that they span together, which
lose nothing to a model that is linear in them.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.gap.experiment_design.candidates import Ray, rays_of
from loose_env.gap.experiment_design.library import battery, check_motion
from loose_env.gap.experiment_design.motions import Motion
from loose_env.gap.experiment_design.servo_arm import ServoArm
from loose_env.gap.experiment_design.sizing import (
    STEP,
    BankSettings,
    nuisance_columns,
    residuals,
    sized_rays,
)
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.io import written_beside
from loose_env.typing import Array

__all__ = ["MotionSignatures", "SignatureBank", "signature_bank"]

_FORMAT = "gap signatures 2"
"""Version of what is stored; a change of the computation changes it."""
_CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "loose_env" / "gap"
"""Folder of stored banks."""

_INDISTINGUISHABLE_Z = 2.0
"""Length of a signature beside that of another candidate below which both are one candidate [noise
standard deviations]."""

Say = Callable[[str], None]


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
    outside: float
    """Largest length of a base vector beyond the directions [noise standard deviations]."""

    def projected(self, readings: Array, noise: Array) -> tuple[Array, float]:
        """Residual of readings (n, C): its coordinates (K,) and the rms of the rest."""
        residual = ((readings - self.nominal) / noise).ravel()
        inside = self.basis.T @ residual
        rest = float(residual @ residual - inside @ inside)
        return np.asarray(inside), float(np.sqrt(max(rest, 0.0) / max(len(residual), 1)))


@dataclass(frozen=True, eq=False)
class SignatureBank:
    """Candidates of an arm, a library of motions, and the signatures of ones on the others."""

    arm: ServoArm
    library: tuple[Motion, ...]
    settings: BankSettings
    rays: tuple[Ray, ...]
    """Rays that can be seen on the battery."""
    sizes: tuple[Array, ...]
    """Sizes of each ray's linearisation points."""
    visibilities: tuple[Array, ...]
    """Visibilities there [noise standard deviations]."""
    signatures: tuple[MotionSignatures, ...]
    """By motion."""
    seconds: Array
    """Machine time of each motion [s] (M,)."""
    wear: Array
    """Integral of the squared torque shares of each motion [s] (M,)."""
    shape_columns: tuple[tuple[int, ...], ...] = field(default=())
    """Base vectors of each ray's shape derivatives, at its middle point."""

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
        Folder of stored banks; None to store nothing. The name of a stored one is a digest of arm,
        library, settings and format; its configuration lies beside it as JSON.
    say : callable, optional
        Receives lines of progress.
    """
    settings = settings or BankSettings()
    configuration: dict[str, object] = {
        "format": _FORMAT,
        "arm": arm.key,
        "settings": asdict(settings),
        "rays": [
            [ray.name, ray.effect.variant, *ray.start.tolist()]
            for ray in rays_of(arm, settings.kinds)
        ],
        "library": [asdict(motion) for motion in library],
    }
    if reference is not None:
        configuration["reference"] = [asdict(motion) for motion in reference]
    text = json.dumps(configuration, sort_keys=True, indent=1)
    key = hashlib.sha256(text.encode()).hexdigest()[:16]
    file = None if cache is None else Path(cache) / f"{key}.npz"
    if file is not None and file.is_file():
        stored = _read(file, arm, tuple(library), settings)
        if stored is not None:
            return _distinct(stored)
    sized_on = battery(arm) if reference is None else tuple(reference)
    bank = _computed(arm, tuple(library), sized_on, settings, say or (lambda words: None))
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        written_beside(file, lambda path: _write(path, bank))
        written_beside(file.with_suffix(".json"), lambda path: path.write_text(text))
    return _distinct(bank)


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
    rays, sizes = tuple(bank.rays[k] for k in kept), tuple(bank.sizes[k] for k in kept)
    return replace(
        bank, rays=rays, sizes=sizes,
        visibilities=tuple(bank.visibilities[k] for k in kept),
        signatures=tuple(replace(s, vectors=s.vectors[:, columns]) for s in bank.signatures),
        shape_columns=_shape_columns(rays, bank.arm, sizes),
    )  # fmt: skip


def _write(path: Path, bank: SignatureBank) -> None:
    which = [_key(ray) for ray in bank.rays]
    arrays: dict[str, NDArray[Any]] = {
        "rays": np.array(which),
        "points": np.array([len(own) for own in bank.sizes]),
        "sizes": np.concatenate(bank.sizes),
        "visibilities": np.concatenate(bank.visibilities),
        "seconds": bank.seconds,
        "wear": bank.wear,
    }
    for k, found in enumerate(bank.signatures):
        arrays |= {
            f"basis{k}": found.basis,
            f"nominal{k}": found.nominal,
            f"vectors{k}": found.vectors,
            f"outside{k}": np.array(found.outside),
        }
    with path.open("wb") as out:
        np.savez(out, **arrays)  # type: ignore[arg-type]


def _key(ray: Ray) -> str:
    return json.dumps([ray.name, ray.effect.variant, *np.round(ray.start, 9).tolist()])


def _read(
    file: Path, arm: ServoArm, library: tuple[Motion, ...], settings: BankSettings
) -> SignatureBank | None:
    """A stored bank; None if it cannot be read, such as one cut short."""
    try:
        with file.open("rb") as opened, np.load(opened, allow_pickle=False) as stored:
            found = {name: stored[name] for name in stored.files}
        every = {_key(ray): ray for ray in rays_of(arm, settings.kinds)}
        rays = tuple(every[str(name)] for name in found["rays"])
        signatures = tuple(
            MotionSignatures(
                found[f"basis{k}"],
                found[f"nominal{k}"],
                found[f"vectors{k}"],
                float(found[f"outside{k}"]),
            )
            for k in range(len(library))
        )
        ends = np.cumsum(found["points"])[:-1]
        sizes, seen = (tuple(np.split(found[of], ends)) for of in ("sizes", "visibilities"))
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None
    return SignatureBank(
        arm, library, settings, rays, sizes, seen, signatures, found["seconds"], found["wear"],
        _shape_columns(rays, arm, sizes),
    )  # fmt: skip


def _shape_columns(
    rays: Sequence[Ray], arm: ServoArm, sizes: Sequence[Array]
) -> tuple[tuple[int, ...], ...]:
    at = len(arm.nominal.entries) + sum(map(len, sizes))
    found = []
    for ray in rays:
        count = len(ray.shape_parameters)
        found.append(tuple(range(at, at + count)))
        at += count
    return tuple(found)


def _computed(
    arm: ServoArm,
    library: tuple[Motion, ...],
    reference: tuple[Motion, ...],
    settings: BankSettings,
    say: Say,
) -> SignatureBank:
    rays, sizes, seen = sized_rays(arm, rays_of(arm, settings.kinds), reference, settings, say)
    if not rays:
        raise InvalidData("no candidate effect can be seen on the battery of this arm")
    signatures, seconds, wear = [], [], []
    for k, motion in enumerate(library):
        say(f"signatures, motion {k + 1} of {len(library)}: {motion.description}")
        checked = check_motion(motion, arm)
        seconds.append(checked.seconds)
        wear.append(checked.wear)
        signatures.append(_of_motion(arm, motion.commands(arm), rays, sizes, settings))
    return SignatureBank(
        arm, library, settings, rays, sizes, seen, tuple(signatures), np.array(seconds),
        np.array(wear), _shape_columns(rays, arm, sizes),
    )  # fmt: skip


def _of_motion(
    arm: ServoArm,
    commands: Array,
    rays: Sequence[Ray],
    sizes: Sequence[Array],
    settings: BankSettings,
) -> MotionSignatures:
    base = residuals(arm, commands, [Hypothesis()])[0]
    columns: list[NDArray[Any]] = [nuisance_columns(arm, commands, base)]
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
    basis = _basis(vectors, settings.rank)
    inside = basis.T @ vectors
    outside = np.sqrt(np.maximum(np.sum(vectors**2, axis=0) - np.sum(inside**2, axis=0), 0.0))
    nominal = (base.reshape(-1, len(arm.channels)) * arm.noise).astype(np.float32)
    return MotionSignatures(basis, nominal, inside.astype(np.float32), float(outside.max()))


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
