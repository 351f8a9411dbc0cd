"""Other layouts of the records: the latest one alone, or differences from the nominal arm."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from loose_env.envs import Element, ObservationLayout
from loose_env.wrappers.base import DiagnosisWrapper

__all__ = ["JointSideObservation", "LatestRecord", "MeasuredMinusNominal", "RecordLayout"]

_NOMINAL = "nominal_"
_JOINT_SIDE = ("level", "torque", "level_share", "duration", "joint_rms", "inertia", "valid")
"""Groups of a record that torque, encoder and the excitation give, beside its pose."""


@dataclass(frozen=True, kw_only=True)
class RecordLayout:
    """Layout of a flat observation: global elements, then slots of equal layout."""

    global_elements: tuple[Element, ...]
    """Elements of the pose and of what has been spent."""
    slot_elements: tuple[Element, ...]
    """Elements of one record."""
    slots: int
    """Number of records that are shown."""

    @property
    def space(self) -> spaces.Box:
        """The observation space; an empty slot is zero, whatever its bounds."""
        first, each = self.global_elements, self.slot_elements
        low = [e.low for e in first] + [min(e.low, 0.0) for e in each] * self.slots
        high = [e.high for e in first] + [max(e.high, 0.0) for e in each] * self.slots
        bounds = np.array([low, high], dtype=np.float32)
        return spaces.Box(bounds[0], bounds[1], dtype=np.float32)

    def split(
        self, observation: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Global elements (globals,) and records (slots, slot size) of an observation (size,)."""
        count = len(self.global_elements)
        return observation[:count], observation[count:].reshape(self.slots, -1)


class _RecordWrapper(DiagnosisWrapper):
    """A wrapper that shows the records in another layout."""

    inner: RecordLayout
    """Layout of what is wrapped."""
    layout: RecordLayout
    """Layout of what is shown."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        found: RecordLayout | ObservationLayout = env.get_wrapper_attr("layout")
        self.inner = RecordLayout(
            global_elements=found.global_elements,
            slot_elements=found.slot_elements,
            slots=found.slots,
        )
        self.layout = self._changed()
        self.observation_space = self.layout.space

    def _changed(self) -> RecordLayout:
        """Layout of what is shown."""
        raise NotImplementedError

    def _shown(
        self, start: NDArray[np.float32], records: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Records as they are shown."""
        raise NotImplementedError

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._observation(observation), info

    def step(self, action: Any) -> tuple[NDArray[np.float32], Any, bool, bool, dict[str, Any]]:
        """Take a step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._observation(observation), reward, terminated, truncated, info

    def _observation(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        start, records = self.inner.split(observation)
        return np.concatenate([start, self._shown(start, records).ravel()])


class LatestRecord(_RecordWrapper):
    """Shows the latest record only: a policy with a memory of its own reads them one by one.

    The global elements stay: the pose, and what has been spent. Before the first record, and where
    the latest one is empty, the record is zero.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = LatestRecord(gymnasium.make("loose_env/Vera-v0"))
    >>> env.reset(seed=0)[0].shape
    (66,)
    """

    def _changed(self) -> RecordLayout:
        names = [each.name for each in self.inner.global_elements]
        self._spent = names.index("spent.records")
        self._most = self.diagnosis.settings.max_records
        return replace(self.inner, slots=1)

    def _shown(
        self, start: NDArray[np.float32], records: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        taken = round(float(start[self._spent]) * self._most)
        # Of a layout of one slot there is only that one.
        return np.asarray(records[min(max(taken, 1), len(records)) - 1])


class MeasuredMinusNominal(_RecordWrapper):
    """Shows statistics less what the nominal, healthy arm would show.

    Every element with a nominal twin becomes the difference of the two, each scaled as the
    observation has it; the twin is left out. What has none, pose and excitation, stays.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = MeasuredMinusNominal(gymnasium.make("loose_env/Vera-v0"))
    >>> env.observation_space.shape, env.layout.slot_elements[-1].name
    ((464,), 'lowest_kurtosis')
    """

    def _changed(self) -> RecordLayout:
        elements = self.inner.slot_elements
        index = {each.name: k for k, each in enumerate(elements)}
        twins = {k: index.get(_NOMINAL + each.name) for k, each in enumerate(elements)}
        self._kept = [k for k, e in enumerate(elements) if not e.name.startswith(_NOMINAL)]
        self._pairs = np.array(
            [(k, twins[of]) for k, of in enumerate(self._kept) if twins[of] is not None],
            dtype=np.intp,
        ).reshape(-1, 2)
        shown = [elements[k] for k in self._kept]
        for k, twin in self._pairs:
            own, other = shown[k], elements[twin]
            shown[k] = replace(own, low=own.low - other.high, high=own.high - other.low)
        return replace(self.inner, slot_elements=tuple(shown))

    def _shown(
        self, start: NDArray[np.float32], records: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        shown = records[:, self._kept]
        own, twin = self._pairs.T
        shown[:, own] -= records[:, twin]
        return shown


class JointSideObservation(_RecordWrapper):
    """Shows what torque and encoders give: a robot without accelerometers (thesis, 2.2.2).

    Left are the pose, what has been spent, and of every record its pose, excitation, joint
    motion and apparent inertia, measured and nominal. That a seat is loose shows there nearly as
    well as at the tool; its direction does not.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = gymnasium.make("loose_env/Planar-v0", n_links=2)
    >>> whole, alone = env.observation_space.shape[0], JointSideObservation(env)
    >>> alone.observation_space.shape[0] < whole / 2
    True
    """

    def _changed(self) -> RecordLayout:
        elements = self.inner.slot_elements
        self._kept = [k for k, each in enumerate(elements) if _of_joints(each.name)]
        return replace(self.inner, slot_elements=tuple(elements[k] for k in self._kept))

    def _shown(
        self, start: NDArray[np.float32], records: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        return np.asarray(records[:, self._kept])


def _of_joints(name: str) -> bool:
    """Whether torque, encoders and the excitation give an element of a record."""
    group = name.partition(".")[0].removeprefix(_NOMINAL)
    return group in _JOINT_SIDE or group.endswith("pose")
