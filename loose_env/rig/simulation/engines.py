"""MuJoCo's batched engine, one instance per model layout of the rig's arms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from loose_env.rig.plant import Plant, PlantShop

__all__ = ["Engine", "Engines"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Engine:
    """One batch, in which every arm has its slot."""

    batch: Batch
    """The batch; all its models have the same layout."""
    rest: NDArray[np.float64]
    """State of an arm at rest with all positions zero."""


class Engines:
    """Engines by number of loose degrees of freedom, created on demand.

    All models of a batch must have one layout, and a seat loose in two directions has a joint
    more than one loose in one. Arms whose seats have the same number share an engine; nobody
    else's number changes what an engine does. Arms of another layout leave their slots in it to
    the template of its own, which is never simulated.

    Parameters
    ----------
    shop : PlantShop
        Source of the templates.
    slots : int
        Number of arms.
    threads : int
        Simulation threads; 0 takes all processors.
    """

    def __init__(self, shop: PlantShop, slots: int, threads: int) -> None:
        self._shop, self._slots, self._threads = shop, slots, threads
        self._made: dict[int, Engine] = {}

    def of(self, parts: int) -> Engine:
        """Return the engine for seats with a number of degrees of freedom."""
        found = self._made.get(parts)
        if found is None:
            batch = Batch(self._shop.spare(parts), self._slots, self._threads)
            rest = batch.state[0].copy()
            rest[:] = 0.0
            found = self._made[parts] = Engine(batch=batch, rest=rest)
        return found

    def load(self, plants: Sequence[Plant]) -> None:
        """Load the models of the arms into every engine."""
        for parts in {plant.parts for plant in plants}:
            spare = self._shop.spare(parts)
            models = [plant.model if plant.parts == parts else spare for plant in plants]
            self.of(parts).batch.set_models(models)
