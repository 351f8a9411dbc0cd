"""Bank of signatures: change of readings by every candidate on every library motion, cached.

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
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.gap.experiment_design.candidates import Ray, rays_of
from loose_env.gap.experiment_design.library import battery
from loose_env.gap.experiment_design.motions import Motion
from loose_env.gap.experiment_design.servo_arm import ServoArm
from loose_env.gap.experiment_design.signatures import MotionSignatures, motion_signatures
from loose_env.gap.experiment_design.sizing import BankSettings, SizedRays, sized_rays
from loose_env.io import written_beside
from loose_env.typing import Array

_FORMAT = "gap signatures 3"
"""Version of what is stored; a change of the computation changes it."""
_CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "loose_env" / "gap"
"""Folder of stored banks."""

_INDISTINGUISHABLE_Z = 2.0
"""Length of a signature beside that of another candidate below which both are one candidate [noise
standard deviations]."""

Say = Callable[[str], None]


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
        Folder of stored banks; None to store nothing. A bank is a folder in it, named by a digest
        of arm, candidates, settings and format, with these as JSON. Each motion is a file of its
        own: a computation that was cut short goes on, and a library may grow.
    say : callable, optional
        Receives lines of progress.
    """
    settings, say = settings or BankSettings(), say or (lambda words: None)
    found = rays_of(arm, settings.kinds)
    configuration: dict[str, object] = {
        "format": _FORMAT,
        "arm": arm.key,
        "settings": asdict(settings),
        "rays": [[ray.name, ray.effect.variant, *ray.start.tolist()] for ray in found],
    }
    if reference is not None:
        configuration["reference"] = [asdict(motion) for motion in reference]
    text = json.dumps(configuration, sort_keys=True, indent=1)
    folder = None if cache is None else Path(cache) / _digest(text)
    sized = SizedRays.read(folder / "sizes.npz", found) if folder else None
    if sized is None:
        sized_on = battery(arm) if reference is None else tuple(reference)
        sized = sized_rays(arm, found, sized_on, settings, say)
        if folder is not None:
            written_beside(folder / "bank.json", lambda path: path.write_text(text))
            sized.write(folder / "sizes.npz")
    if not sized.rays:
        raise InvalidData("no candidate effect can be seen on the battery of this arm")
    signatures = []
    for k, motion in enumerate(library):
        file = folder / f"{_digest(json.dumps(asdict(motion)))}.npz" if folder else None
        own = MotionSignatures.read(file) if file else None
        if own is None:
            say(f"signatures, motion {k + 1} of {len(library)}: {motion.description}")
            own = motion_signatures(arm, motion, sized, settings.rank)
            if file is not None:
                own.write(file)
        signatures.append(own)
    return _distinct(SignatureBank(arm, tuple(library), settings, sized, tuple(signatures)))


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


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
