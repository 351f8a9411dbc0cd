"""Single Gymnasium environment `DiagnosisEnv`: one arm with a hidden fault; its saved state."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakValueDictionary

import gymnasium
import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm
from loose_env.envs.batch import BatchRig, Beginning, EnvBatch
from loose_env.envs.rendering import Picture
from loose_env.envs.settings import DiagnosisSettings
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.typing import IndexArray


@dataclass(frozen=True, kw_only=True, eq=False)
class EnvState:
    """All that the future of an environment or a batch depends on, beside its arguments."""

    batch: Mapping[str, Any]
    """Seeds, hidden faults, true arms, poses and records, as `EnvBatch.state` gives them."""
    fingerprint: str
    """Of the arm and the settings that it is a state of."""


class BatchShell:
    """What single and vector environments of a batch share: beginnings, states, pictures.

    A copy is built anew from the arguments and takes up the state: no engine is copied.
    """

    batch: EnvBatch
    render_mode: str | None
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 2}  # noqa: RUF012
    _kept: tuple[str, ...]
    """Attributes that a copy takes over."""

    def _show(self, batch: EnvBatch, render_mode: str | None, **arguments: Any) -> None:
        """Show a batch; ``arguments`` are those beside arms, settings, threads and render mode."""
        if render_mode not in (None, "rgb_array"):
            raise UnknownName(
                f"unknown render_mode {render_mode!r}; the mode is 'rgb_array', whose pictures of "
                "one environment gymnasium.wrappers.HumanRendering shows in a window"
            )
        self.batch, self.render_mode, self._arguments = batch, render_mode, arguments
        self.arm, self.settings = batch.arm, batch.settings
        self.hypotheses, self.verdicts = batch.hypotheses, batch.verdicts
        self.layout, self.actions = batch.observations, batch.actions
        self._picture: Picture | None = None

    def _begin(
        self,
        chosen: Sequence[int] | IndexArray,
        seeds: Sequence[int | None],
        options: Sequence[Mapping[str, Any] | None],
    ) -> None:
        """Begin the first episodes of root seeds, or the next ones of the arms' own."""
        batch = self.batch
        given = [batch.seeds[i] if seeds[i] is None else seeds[i] for i in chosen]
        if len(chosen):
            batch.start_all(
                chosen,
                seeds=[new_seed() if root is None else root for root in given],
                numbers=[0 if seeds[i] is not None else batch.numbers[i] + 1 for i in chosen],
                beginnings=[Beginning.of(options[i], batch.true_arm) for i in chosen],
            )

    def get_state(self) -> EnvState:
        """Copy of the state: `set_state` goes on from it, here or in an environment like it."""
        return EnvState(batch=self.batch.state(), fingerprint=self.batch.fingerprint)

    def set_state(self, state: EnvState) -> None:
        """Go on from a state that `get_state` gave.

        Raises
        ------
        InvalidSetting
            If it is none, or of another arm, other settings or another number of environments.
        """
        num = self.batch.num
        if not isinstance(state, EnvState) or len(state.batch["seeds"]) != num:
            raise InvalidSetting(
                f"a state of {num} environment{'s' * (num > 1)} is what get_state() of as many "
                f"gives; got {state!r:.60}"
            )
        if state.fingerprint != self.batch.fingerprint:
            raise InvalidSetting(
                "the state was taken from an environment of another arm or other settings; make "
                "this environment with the same arguments"
            )
        self.batch.restore(state.batch)

    def _drawn(self) -> list[Any]:
        """Picture of every arm's episode."""
        if self.render_mode is None:
            raise UnknownName("no render_mode was given; make the environment with 'rgb_array'")
        episodes = [self.batch.episode(i) for i in range(self.batch.num)]
        if self._picture is None:
            self._picture = Picture(self.batch.nominal, sensors=self.settings.sensors)
        return [self._picture.draw(each, verdict=each.verdict) for each in episodes]

    @property
    def divergences(self) -> dict[str, int]:
        """Number of diverged simulations by fault kind."""
        return dict(self.batch.divergences)

    def __getstate__(self) -> dict[str, Any]:
        """Arguments and state."""
        batch = self.batch
        own = {"arm": batch.arm, "true_arm": batch.true_arm, "settings": batch.settings}
        own |= {"threads": batch.threads, "render_mode": self.render_mode}
        kept = {name: getattr(self, name) for name in self._kept}
        return {"arguments": own | self._arguments, "state": self.get_state(), "attributes": kept}

    def __setstate__(self, stored: dict[str, Any]) -> None:
        """Build the environment from its arguments and take up the state."""
        self.__init__(**stored["arguments"])  # type: ignore[misc]
        self.set_state(stored["state"])
        self.__dict__.update(stored["attributes"])


class DiagnosisEnv(BatchShell, gymnasium.Env[Any, NDArray[np.int64]]):
    """Find the fault hidden in a robot arm.

    ## Description
    An arm may have a link that slides on its flange, a joint with play, or nothing wrong. The agent
    moves joints, shakes some of them with band-limited Gaussian torque while the others are held,
    and sees how the tool's acceleration correlates with the excitation. It names the fault when it
    is sure; every record has its price. What fits no hypothesis it may leave unnamed: the verdict
    is then "unsure". `verdicts` lists what can be said, in order.

    ## Action Space
    `MultiDiscrete`, in this order:

    | entries | choices | meaning |
    |---|---|---|
    | one a joint | 5 | relative move: -90, -45, 0, 45, 90 degrees |
    | one a joint | 4 | excitation: 0 off, levels 1 to 3 (rms acceleration of the nominal tool) |
    | 1 | 3 | record length: 0.2, 0.4, 1.2 s |
    | 1 | 2 + hypotheses | verdict: 0 go on, k name the k-th hypothesis, the last one unsure |

    Where `max_moved` or `max_excited` is less than the number of joints n, the moves or levels have
    an entry for each joint that may be moved or excited at once, in place of one for each joint: 0
    for none, else 1 + j (choices - 1) + k for the k-th move (0 degrees left out) or level of joint
    j, both from 0. `actions.encode` and `actions.decode` translate.

    A joint that slides goes in proportion through its range: 90 degrees are half of it. With a
    verdict nothing is measured and the rest is ignored. Levels beyond a joint's torque limit
    are clipped; the share that remains is in the observation and in `info["level_share"]`. With
    all levels off the last joint is excited at its top level, for a record without excitation shows
    nothing. With no torque left beside gravity the arm moves, a record is spent and its slot stays
    empty. `action_masks()` and `info["action_mask"]` say what makes sense: no move past a joint
    limit (such a joint stays), no verdict before the first measured record (it is ignored, and the
    rest of the action is done), no "unsure" before the third one (ignored too; `unsure_after`), no
    going on after the last record (it ends the episode as a wrong verdict).

    ## Observation Space
    A flat float32 `Box` with finite bounds: the pose and what has been spent, then a slot for
    each record: pose, excitation, the record's statistics, and the same statistics as the
    nominal healthy arm would show them. A hinge's place is its sine and cosine, a slide's
    runs from -1 at the low end of its range to 1, and so does a second one of hinges whose range
    is more than a whole turn; `layout.pose_of` reads the pose back. `layout`
    lists every element with name, unit and scaling; `print(env.unwrapped.layout.table())` shows
    them. With `raw=True` a `Dict` of the same vector as `"statistics"` and the signals of the
    latest record. With
    `SensorSuite(link_accelerometers=...)` each slot also holds the transmission to the sensors on
    links, the nominal one and their rms, and `raw` has their signals as `"links"`; the agent
    `local` reads them. With `rhythm=True` it holds how loudly the record rang above the excited
    band and how well knocks of each seat would explain when it did (`rhythm`).

    ## Rewards
    +1 for the right hypothesis, -1 for a wrong one or for running out of records, -0.25 for being
    unsure; less the prices of each record (0.05), second of excitation (0.02) and level (0.002). A
    joint that is moved costs nothing unless `prices.move` says so.

    ## Starting State
    A fault drawn from the difficulty's ranges, a true arm that differs from the nominal one, a
    random pose. Nothing is measured.

    ## Episode End
    A verdict terminates, and so does going on after the last record. A simulation that
    diverges truncates; `info["failure"]` says why, `divergences` counts by fault kind.

    ## Arguments
    `difficulty`, `max_records`, `prices` and all other fields of `DiagnosisSettings`. `kinds` are
    those of "healthy", "structural_looseness" and "backlash" that are hypotheses, all by default.
    `hold` says how joints that are not excited are held: "brake", "servo", or "compliant", by
    brakes behind elastic gears. `levels` replaces the arm's excitation levels [m/s²]; the friction
    that is drawn stays relative to the arm's own top level, so that weaker levels open fewer seats.
    `gravity` is a vector in the world's axes [m/s²], such as (9.81, 0, 0) for an arm on a wall. For
    the planar arm also `n_links` and `vertical`; for `loose_env/Arm-v1` `model`, the path of an
    MJCF or URDF file, `tool`, `tool_offset` and `joints`. Where the tool lies on a joint's axis it
    does not feel play there, which is no hypothesis then; `tool_offset`, three lengths in metres in
    the tool's frame, moves the accelerometer off it. `true_arm` is the arm that is measured, where
    the nominal model is wrong about more than `difficulty` says, an effect that it lacks above all;
    for `loose_env/Arm-v1` `true_model`, the path of its file. Without it the nominal arm is
    measured, with the difficulty's mismatch.

    Options of `reset` hold for one episode. `{"fault": ...}` seats a given fault, or one drawn
    under a given hypothesis. It may lie outside the hypotheses, as "several_faults" does, two
    faults drawn at once, or a `RotationalLooseness` of `loose_env.faults`: then no name is right.
    `{"mismatch_scale": 3.0}` multiplies the deviations of the true arm from the nominal one,
    `{"preload_g": 1.0}` presses the loose seat towards its upper stop with so many times the weight
    it carries (`loose_env.faults.preloaded`), `{"pose": ...}` sets the first pose.

    ## Version History
    * v1, where hinges turn by more than a whole turn: they show their place in their range
    * v0: first version

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> env = DiagnosisEnv(planar(2), DiagnosisSettings(max_records=2))
    >>> observation, info = env.reset(seed=0)
    >>> observation in env.observation_space
    True
    """

    _kept = ("spec", "action_space", "_np_random", "_np_random_seed")

    def __init__(
        self,
        arm: Arm,
        settings: DiagnosisSettings | None = None,
        *,
        render_mode: str | None = None,
        rig: BatchRig | None = None,
        threads: int = 0,
        true_arm: Arm | None = None,
    ) -> None:
        batch = EnvBatch(arm, settings, threads=threads, rig=rig, true_arm=true_arm)
        self._show(batch, render_mode, rig=rig)
        self.action_space = self.actions.space
        self.observation_space = self.batch.space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Hide a fault and take a random pose; measures nothing."""
        super().reset(seed=seed)
        if seed is not None:
            self._warn_of_neighbour(seed)
        self._begin([0], [seed], [options])
        return row_of(self.batch.shown([0]), 0), {"action_mask": self.batch.masks([0])[0]}

    def step(self, action: NDArray[np.int64]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Move, excite and measure; or give a verdict."""
        found = self.batch.step([0], [action])
        reward, over, cut = (each[0].item() for each in found.arrays)
        return row_of(self.batch.shown([0]), 0), reward, over, cut, found.info(0)

    def _warn_of_neighbour(self, seed: int) -> None:
        """Warn where seeds count up over environments alike, as other vector environments do."""
        before, _SEEDED[seed] = _SEEDED.get(seed - 1), self
        if self.batch.begun[0] or before is None or before.batch.seeds[0] != seed - 1:
            return  # one after the other is no batch
        if before.batch.fingerprint == self.batch.fingerprint:
            warnings.warn(
                f"two environments alike were seeded {seed - 1} and {seed}: runs of neighbouring "
                "seeds will share episodes. Give stable-baselines3's make_vec_env "
                "vec_env_cls=loose_env.envs.sb3.KeyedDummyVecEnv, or use gymnasium.make_vec",
                UserWarning,
                stacklevel=3,
            )

    def action_masks(self) -> NDArray[np.bool_]:
        """Allowed choices of the next action, in the form MaskablePPO takes."""
        return np.asarray(self.batch.masks([0])[0])

    def render(self) -> Any:
        """Draw the arm in its pose with the latest record."""
        return self._drawn()[0]


_SEEDED: WeakValueDictionary[int, DiagnosisEnv] = WeakValueDictionary()
"""Single environment of this process that each seed was last given to."""


def row_of(observations: Any, k: int) -> Any:
    """One of several observations, flat or raw."""
    if isinstance(observations, dict):
        return {key: part[k] for key, part in observations.items()}
    return observations[k]


def new_seed() -> int:
    """Draw a seed from the system, where the user gives none."""
    entropy = np.random.SeedSequence().entropy
    assert isinstance(entropy, int)
    return entropy
