"""Force balance along a measured motion: what a model needs less what its drives give.

One general rule makes the column of an effect: the balance of the nominal model minus that of the
edited one, at the same motion. An effect needs nothing for that but its MJCF edit, its command map,
its torque or its reading of the drive torque. Dry friction is no constraint here, whose force at
rest is a reaction, but the friction loss times the direction of sliding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from functools import partial
from itertools import product

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch
from scipy.optimize import minimize

from loose_env.gap.core.motion import FINER, Motion, RunMotion, finer, low_passed, mirrored
from loose_env.gap.core.readings import Readings
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.drives import CommandInterpolation, DriveLimit
from loose_env.gap.model.effects.inertia import MountedPayload
from loose_env.gap.model.effects.sensors import EncoderOffset, column_of
from loose_env.gap.model.hypothesis import compiled
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.simulator import sizes_of
from loose_env.typing import Array

_OFF = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
_DRIVES = 29  # group of the machine's own drives, off in runs without commands
_POSES = 24  # states at which the mean operator is read
_NUDGE = 1e-4  # displacement of numerical derivatives [rad, m]

_MOST_LOAD = 0.9  # share of a drive's torque from which friction by load would lock it
_MODEL = 1e-4  # error of any torque, as a share of the typical one: rounding, integration
_SPRINGS, _DAMPINGS = 90, (0.02, 0.06, 0.2)
"""Stiffnesses and damping ratios that are tried for an added spring."""
_STIFFEST = 4.0
"""Highest frequency of such a mode over the end of the band: beyond, it only gives way."""
_ROUNDS, _CONVERGED = 12, 0.02
"""Rounds of the motion of an added joint whose inertia varies, at most, and the share of its
acceleration that may be left."""
_RESONANCES = 3  # springs that are started from

CONTACTS: dict[str, tuple[str, float]] = {
    "sliding 0.2%": ("speed", 0.002),
    "sliding 1%": ("speed", 0.01),
    "sliding 4%": ("speed", 0.04),
    "sliding 12%": ("speed", 0.12),
    "presliding 0.06%": ("range", 0.0006),
    "presliding 0.2%": ("range", 0.002),
    "presliding 1%": ("range", 0.01),
}
"""Ways in which dry friction turns at a reversal: over a speed, as a share of the typical one, or
over a presliding distance (Dahl), as a share of the range of motion."""
USUAL = "sliding 4%"


Found = tuple[tuple[Effect, Array], ...]
"""Effects with their values."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Forces:
    """Change of the balance that an effect makes, dry friction apart."""

    smooth: Array  # Change of the balance [N·m, N] (T, joints)
    dry: Array  # Dry friction to be multiplied by the direction of sliding (T, joints)
    readings: Array  # Change of the readings beside the motion (T, R)
    operator: Array
    """Change of the mean inertia, damping and stiffness matrices, drives included (3, joints,
    joints)."""
    eased: Array | float = 0.0  # Share of the time in which a drive holds nothing (joints,)

    def less(self, other: Forces) -> Forces:
        """The difference to another change."""
        names = ("smooth", "dry", "readings", "operator")
        return Forces(**{name: getattr(self, name) - getattr(other, name) for name in names})

    def with_contact(self, direction: Array) -> Array:
        """The whole change for a direction of sliding (T, joints + R)."""
        return np.hstack([self.smooth + self.dry * direction, self.readings])


class Change:
    """Change of the balance along the motion, of the channels that it reaches.

    In single precision: a hundred columns of an hour's motion would not fit otherwise.
    """

    def __init__(self, whole: Array) -> None:
        self.shape = whole.shape
        reached = np.flatnonzero(np.any(whole, axis=0))
        self._series = {int(k): whole[:, k].astype(np.float32) for k in reached}

    def reaches(self, channel: int) -> bool:
        """Whether a channel changes."""
        return channel in self._series

    def at(self, channel: int) -> Array:
        """Change of one channel (T,)."""
        found = self._series.get(channel)
        return np.zeros(self.shape[0]) if found is None else found.astype(float)

    def whole(self) -> Array:
        """Change of all channels that it was made of (T, C)."""
        return np.stack([self.at(k) for k in range(self.shape[1])], axis=1)


class Balance:
    """Force balance of a machine along a measured motion."""

    def __init__(self, machine: NominalModel, motion: Motion) -> None:
        self.motion, self.machine = motion, machine
        self._sensed: dict[tuple[str, str, str], list[Array]] = {}
        self._batches: dict[tuple[object, ...], tuple[Batch, list[Array]]] = {}
        self._resting: tuple[mujoco.MjModel, Array, Array] | None = None
        self.found: Found = ()
        self._known: dict[tuple[object, ...], Forces] = {}
        self.position, self.speed = motion.stacked("position"), motion.stacked("speed")
        self._poses = np.linspace(0, len(self.position) - 1, _POSES).astype(int)
        self.acceleration = motion.stacked("acceleration")
        self.commands, self.torques = motion.stacked("commands"), motion.stacked("torques")
        sizes = [len(run.position) for run in motion.runs]
        self.forms = np.repeat([run.form for run in motion.runs], sizes)
        self.released = self.forms != "forward"
        span = np.ptp(self.position, axis=0)
        self.usual = np.percentile(np.abs(self.speed), 95, axis=0)  # speed of each joint
        scales = np.maximum(self.usual, 1e-9), span
        self.directions = {
            name: np.concatenate([_direction(motion, run, law, *scales) for run in motion.runs])
            for name, law in CONTACTS.items()
        }
        model = compiled(machine.fresh())
        self.needed, self.given = self._forces(model, self.commands)
        self.dry = np.broadcast_to(model.dof_frictionloss, self.needed.shape)
        still = self.position, self.speed, 0 * self.speed
        self.bias = self._forces(model, self.commands, still)[0]  # gravity and inertial coupling
        self.operator, self.varied = self._operators(model)
        self._nominal = model
        self.stiffness = np.zeros(len(machine.joints))
        if not self.released.all():
            self.stiffness = np.diag(self._operators(model, drives=True)[0, 2]).copy()
        self.encoders = {n: machine.joints.index(j) for n, j in machine.encoders.items()}
        measured = np.isfinite(self.torques)
        inverse = (self.forms == "inverse")[:, None]
        self.seen = np.where(inverse, measured, True)
        self.seen[:, [*motion.followers, *motion.foretold]] = False
        self.drive = np.where(inverse & measured, self.torques, self.given)
        left = self.drive - self.needed - self.dry * self.directions[USUAL]
        self.readings = Readings(compiled(machine.fresh()), motion)
        off = motion.stacked("readings") - self.readings.foretold
        self.residual = self.folded(np.hstack([left, off]))
        self.channels = (*machine.joints, *self.readings.names)

    def beside(self, found: Iterable[tuple[Effect, Array]]) -> Balance:
        """The same with the changes by rigid bodies beside effects that were found."""
        balance = copy(self)
        balance.found, balance._known = tuple(found), {}
        return balance

    def known(self, found: Found) -> Forces:
        """Change of the balance by some effects that were found, at once."""
        key = tuple(effect.key for effect, _ in found)
        if key not in self._known:
            self._known[key] = self.edited(with_effects(self.machine, found))
        return self._known[key]

    def folded(self, whole: Array, rows: Array | slice = slice(None)) -> Array:
        """Balance (..., T, channels) in which what acts on followers acts at the other joints."""
        own = list(self.motion.followers)
        if not own:
            return whole
        whole, paths = whole.copy(), self.motion.stacked("followed")[rows]
        whole[..., : paths.shape[2]] += np.einsum("...tp,tpj->...tj", whole[..., own], paths)
        whole[..., own] = 0.0
        return whole

    def change(self, whole: Array) -> Change:
        """Change of the balance by the forces of some effect (T, channels)."""
        return Change(self.folded(whole))

    def forces(self, effect: Effect, values: Array) -> Forces:
        """Change of the balance by an effect at some values of its parameters."""
        if isinstance(effect, MountedPayload):
            return self._by_run(effect, values)
        others = tuple(own for own in self.found if own[0].key != effect.key)
        if others and is_rigid(effect):
            both = with_effects(self.machine, (*others, (effect, values)))
            return self.edited(both).less(self.known(others))
        model, commands = None, self.commands
        if effect.overrides("edit") and not effect.overrides("torque_along"):
            spec = self.machine.fresh()
            effect.edit(spec, values)
            model = compiled(spec)
        if isinstance(effect, CommandInterpolation):
            straight = self.motion.stacked("straight")
            commands = commands + values[0] * (straight - commands)
        elif effect.overrides("command"):
            commands = np.concatenate(
                [
                    _commanded(effect, run, values) if run.form == "forward" else run.commands
                    for run in self.motion.runs
                ]
            )
        encoder = self._misread(effect, values)
        if encoder:
            return self._read_otherwise(encoder, commands, effect, values)
        commands = effect.feedback(commands, self.position, self.speed, values)
        return self._change(model, commands, effect, values)

    def _by_run(self, effect: MountedPayload, values: Array) -> Forces:
        """Change of the balance by a payload that runs have in different ways."""
        sizes = [len(run.position) for run in self.motion.runs]
        names = np.repeat([run.name for run in self.motion.runs], sizes)
        parts = [self.forces(*effect.plain(values, way)) for way in range(len(effect.mountings))]
        its = [np.isin(names, runs)[:, None] for runs in effect.mountings]
        pairs = list(zip(its, parts, strict=True))

        def mixed(name: str) -> Array:
            return np.asarray(sum(np.where(own, getattr(part, name), 0.0) for own, part in pairs))

        return Forces(
            smooth=mixed("smooth"), dry=mixed("dry"), readings=mixed("readings"),
            operator=np.asarray(sum(own.mean() * part.operator for own, part in pairs)),
        )  # fmt: skip

    def _misread(self, effect: Effect, values: Array) -> str:
        """Position sensor that reads otherwise by an effect than its joint moves; "" if none."""
        if not effect.overrides("read"):
            return ""
        sizes = zip(self.machine.sensors, self.machine.model.sensor_dim, strict=True)
        still = {column_of(n): np.zeros((2, size) if size > 1 else 2) for n, size in sizes}
        shown = effect.read(np.arange(2.0), still, values)
        return next((n for n in self.encoders if shown[c := column_of(n)] is not still[c]), "")

    def _read_otherwise(
        self, encoder: str, commands: Array, effect: Effect, values: Array
    ) -> Forces:
        """Change by a position sensor that reads otherwise than the joint moves."""
        # The balance along the motion that the joint then made. Its drive knew that motion, or by
        # the effect's feedback what the sensor showed.
        joint, column = self.encoders[encoder], column_of(encoder)
        parts, shares = [], []
        for run, q in zip(self.motion.runs, self.motion.split(self.position), strict=True):
            own = q[:, joint]
            swing = off = own - own.mean()
            if not effect.is_time_shift:
                off = self._unread(run, own, column, effect, values)
            turn, wave = mirrored(off, self.motion.step)
            if effect.is_time_shift:
                wave = (np.exp(1j * turn * values[0]) - 1) * wave
            parts.append([np.fft.irfft((1j * turn) ** k * wave)[: len(own)] for k in range(3)])
            shares.append((float(swing @ parts[-1][0]), float(swing @ swing)))
        moved = [np.concatenate([part[k] for part in parts]) for k in range(3)]
        states = []
        for known, more in zip((self.position, self.speed, self.acceleration), moved, strict=True):
            states.append(known.copy())
            states[-1][:, joint] += more
        commands = effect.feedback(commands, states[0], states[1], values)
        needed, given = self._forces(self._nominal, commands, (states[0], states[1], states[2]))
        # the noise of a joint that moves less than is read is less, too
        more, whole = np.sum(shares, axis=0)
        operator = np.zeros_like(self.operator)
        if not effect.is_time_shift:
            operator[..., joint] = more / (whole + 1e-300) * self.operator[..., joint]
        turned = self.readings.turned(joint, moved)
        return Forces(
            smooth=needed - given - (self.needed - self.given),
            dry=np.zeros_like(needed),
            readings=self.readings.change(
                None, effect, values, turned=turned, positions={column: states[0][:, joint]}
            ),
            operator=operator,
        )

    def _unread(
        self, run: RunMotion, own: Array, column: str, effect: Effect, values: Array
    ) -> Array:
        """Way of a joint beyond what a sensor shows of it, in the band of the motion (T,)."""
        shown = finer(own[:, None])[:, 0]
        time = np.arange(len(shown)) * run.step / FINER

        def left(off: Array) -> Array:
            return np.asarray(shown - effect.read(time, {column: shown + off}, values)[column])

        off = left(np.zeros_like(shown))
        off = off + left(off)
        return low_passed(off[:, None], self.motion.band, run.step / FINER)[::FINER, 0]

    def edited(self, spec: mujoco.MjSpec) -> Forces:
        """Change of the balance by an edit of the spec alone."""
        return self._change(compiled(spec), self.commands, None, np.empty(0))

    def _change(
        self, model: mujoco.MjModel | None, commands: Array, effect: Effect | None, values: Array
    ) -> Forces:
        felt = self.readings.nothing
        same = commands is self.commands
        if model is None or (same and _same_forces(model, self._nominal)):
            needed, given = self.needed.copy(), self.given if same else self.given_by(commands)
        elif model.nv > self.needed.shape[1]:
            needed, given, felt = self._with_hidden_joint(model, commands, effect)
        else:
            needed, given = self._forces(model, commands)
        dry = np.zeros_like(needed)
        if model is not None:
            dry += model.dof_frictionloss[self._dofs(model)] - self.dry
        operator = np.zeros_like(self.operator)
        eased = np.zeros(self.needed.shape[1])
        edited = given is not self.given and model is not None
        if edited and isinstance(effect, DriveLimit):
            # a drive at its limit holds nothing there, and as before elsewhere
            reached = np.mean(np.abs(given - self.given) > _MODEL * np.abs(self.given), axis=0)
            eased = reached * (self.stiffness != 0)
        elif edited and model is not None and model.nv == self.needed.shape[1]:
            operator = self._operators(model)[0] - self.operator
        elif model is not None and model.nv > self.needed.shape[1] and (self.forms == "free").all():
            # what a hidden joint leaves of the forces that the motion takes
            ratio = np.sum(needed * self.needed, axis=0) / np.sum(self.needed**2, axis=0)
            operator[0] = (ratio - 1)[:, None] * self.operator[0]
        needed = needed - given
        if effect is not None:
            if effect.overrides("torque", "torque_along"):
                paths = zip(
                    self.motion.split(self.position), self.motion.split(self.speed), strict=True
                )
                needed -= np.concatenate([effect.torque_along(q, v, values) for q, v in paths])
            if effect.overrides("dry_friction"):
                loads = self._loads(effect, values)
                dry += effect.dry_friction(loads, self.bias, self.speed, values)
            if effect.overrides("sensed_torque"):
                inverse = self.forms == "inverse"
                for joint, name in enumerate(self.machine.joints):
                    sensed = effect.sensed_torque(name, needed[:, joint], values)
                    needed[:, joint] = np.where(inverse, sensed, needed[:, joint])
                    if inverse.all():
                        (gain,) = np.diff(effect.sensed_torque(name, np.arange(2.0), values))
                        operator[:, joint] += (gain - 1) * self.operator[:, joint]
        return Forces(
            smooth=needed - (self.needed - self.given),
            dry=dry,
            readings=self.readings.change(model, effect, values) + felt,
            operator=operator,
            eased=eased,
        )

    def _loads(self, effect: Effect, values: Array) -> Array:
        """Drive torques that carry a friction by load beside what the model needs (T, joints)."""
        # Not the drive's own torque, which contains all other friction as well.
        none, one = (
            effect.dry_friction(np.full_like(self.needed, load), self.bias, self.speed, values)
            for load in (0.0, 1.0)
        )
        share, direction = np.minimum(one - none, _MOST_LOAD), self.directions[USUAL]
        carried = self.needed + direction * (none + self.dry)
        driven = carried / (1 - share * np.sign(carried) * direction)
        return np.where((self.forms == "free")[:, None], 0.0, driven)

    def _dofs(self, model: mujoco.MjModel) -> Array:
        """Degree of freedom of each of the machine's joints in an edited model."""
        return np.array([int(model.joint(name).dofadr[0]) for name in self.machine.joints])

    def _forces(
        self,
        model: mujoco.MjModel,
        commands: Array,
        states: tuple[Array, Array, Array] | None = None,
    ) -> tuple[Array, Array]:
        """Forces that a model needs, and that its actuators give, along the motion (T, nv)."""
        position, speed, acceleration = states or (self.position, self.speed, self.acceleration)
        released = self.released if len(position) == len(self.released) else self.released[:1]
        model.opt.disableflags |= _OFF
        model.actuator_group[: self.machine.model.nu] = _DRIVES
        needed, given = np.empty_like(acceleration), np.empty_like(acceleration)
        for off in np.unique(released):
            rows = np.broadcast_to(released == off, len(position))
            model.opt.disableactuator = int(off) << _DRIVES
            batch, (mass, bias, passive, acting) = self._batch(model, int(rows.sum()))
            batch.set_models(model)
            batch.qpos[:], batch.qvel[:] = position[rows], speed[rows]
            batch.ctrl[:, : commands.shape[1]] = commands[rows]
            batch.forward()
            moved = np.einsum("tij,tj->ti", _dense(model, mass), acceleration[rows])
            needed[rows] = moved + bias - passive
            given[rows] = acting
        return needed, given

    def given_by(self, commands: Array) -> Array:
        """Forces of the nominal actuators for other commands (T, joints)."""
        return self._forces(self._nominal, commands)[1]

    def late(self, actuator: int, order: int) -> Array:
        """Derivative of the balance by the delay of one actuator's commands (T, joints)."""
        # The first, or the second without its sign.
        changed = self.commands.copy()
        # small, so that no limit is reached by it
        size = (_NUDGE * self.motion.step) ** order
        changed[:, actuator] -= size * self.motion.rates(self.commands[:, actuator], order)
        return (self.given - self.given_by(changed)) / size

    def at_samples(self) -> Iterator[tuple[Array, Array]]:
        """Acceleration at samples beyond its mean between them, by each actuator (T, joints)."""
        # Where commands are held from sample to sample, and where straight lines join them. An
        # accelerometer that is read as a held command steps sees all of the step, which acts half
        # an interval late on the mean.
        mass = _dense(self._nominal, self._masses(self._nominal, self.position))
        known = {name: self.motion.stacked(name) for name in ("sampled", "commands", "straight")}
        for actuator in range(self.commands.shape[1]):
            given = {}
            for name, values in known.items():
                commands = self.commands.copy()
                commands[:, actuator] = values[:, actuator]
                given[name] = self.given_by(commands)
            beyond = [given["sampled"] - given[name] for name in ("commands", "straight")]
            held, straight = np.linalg.solve(mass, np.stack(beyond)[..., None])[..., 0]
            yield held, straight

    def _masses(self, model: mujoco.MjModel, position: Array) -> Array:
        """Packed mass matrices at some positions (T, nC)."""
        batch, (mass, *_) = self._batch(model, len(position))
        batch.set_models(model)
        batch.qpos[:] = position
        batch.forward(stage=mujoco.mjtStage.mjSTAGE_POS)
        return mass.copy()

    def _batch(self, model: mujoco.MjModel, count: int) -> tuple[Batch, list[Array]]:
        """Batch with room for all samples, and its mass matrices and forces."""
        key = (sizes_of(model), count, tuple(model.jnt_bodyid))
        if key not in self._batches:
            if len(self._batches) > 3:
                self._batches.pop(next(iter(self._batches)))
            batch = Batch(model, count, 1)
            names = ("M", "qfrc_bias", "qfrc_passive", "qfrc_actuator")
            self._batches[key] = batch, [batch.bind(name) for name in names]
        return self._batches[key]

    def _slopes(
        self, model: mujoco.MjModel, states: Sequence[Array], rows: Array, joints: Sequence[int]
    ) -> Array:
        """Slopes of the forces needed and given by some joints' motion (2, 3, K, T, nv)."""
        # By acceleration, speed and position, at some samples.
        sizes = np.array([1.0, _NUDGE, _NUDGE])
        base = [x[rows] for x in states[::-1]]
        every = [base]
        for order, joint in product(range(3), joints):
            every.append([x.copy() for x in base])
            every[-1][order][:, joint] += sizes[order]
        a, v, q = (np.concatenate([s[k] for s in every]) for k in range(3))
        forces = np.array(
            self._forces(model, np.tile(self.commands[rows], (len(every), 1)), (q, v, a))
        ).reshape(2, len(every), len(rows), -1)
        changes = (forces[:, 1:] - forces[:, :1]).reshape(2, 3, len(joints), len(rows), -1)
        return np.asarray(changes / sizes[:, None, None, None])

    def _operators(self, model: mujoco.MjModel, *, drives: bool = False) -> Array:
        """Mean and variance of inertia, damping, stiffness, with drives or theirs (2, 3, J, J)."""
        states, joints = (self.position, self.speed, self.acceleration), len(self.machine.joints)
        needed, given = self._slopes(model, states, self._poses, range(joints))
        change = self.folded(-given if drives else needed - given, self._poses)
        return np.stack([change.mean(axis=2), change.var(axis=2)]).swapaxes(2, 3)

    def _with_hidden_joint(
        self, model: mujoco.MjModel, commands: Array, effect: Effect | None
    ) -> tuple[Array, Array, Array]:
        """Forces and readings of a model with one more joint, which moves as its spring lets it."""
        # The joint's own motion is its response to the force that the measured motion puts on it,
        # with an inertia that varies with the pose, by generalised conjugate residuals (Eisenstat,
        # Elman and Schultz, SIAM J. Numer. Anal. 20, 1983) from the response of the mean.
        hidden = self._hidden(model, commands)
        zero, varied = np.zeros(len(self.position)), hidden.inertia - hidden.own[0]
        moved, rest = np.zeros((3, len(zero))), self._response(hidden, hidden.force)
        known: list[tuple[Array, Array]] = []
        for _ in range(_ROUNDS):
            way, reply = rest, rest - self._response(hidden, varied * rest[2])
            for earlier, gave in known:
                share = gave[2] @ reply[2] / (gave[2] @ gave[2])
                way, reply = way - share * earlier, reply - share * gave
            known.append((way, reply))
            share = reply[2] @ rest[2] / (reply[2] @ reply[2] + 1e-300)
            moved, rest = moved + share * way, rest - share * reply
            if np.linalg.norm(rest[2]) <= _CONVERGED * np.linalg.norm(moved[2]):
                break
        needed, given = self._forces(model, commands, hidden.states(*moved))
        seen = self._hidden_readings(model, effect, hidden, list(moved))
        return needed[:, hidden.seen].copy(), given[:, hidden.seen].copy(), seen

    def _response(self, hidden: _Hidden, force: Array) -> Array:
        """Motion of a joint of the mean inertia, damping and stiffness under a force (3, T)."""
        inertia, damping, stiffness = hidden.own
        parts = []
        for own in self.motion.split(force):
            turn, wave = mirrored(own, self.motion.step)
            wave = -wave / (
                stiffness + 1j * turn * damping - inertia * turn**2 + 1e-12 * abs(stiffness)
            )
            parts.append([np.fft.irfft((1j * turn) ** k * wave)[: len(own)] for k in range(3)])
        return np.concatenate(parts, axis=1)

    def _hidden_readings(
        self, model: mujoco.MjModel, effect: Effect | None, hidden: _Hidden, moved: list[Array]
    ) -> Array:
        """Change of inertial readings by the motion of a hidden joint, to first order (T, R)."""
        if effect is None or not any(axis >= 0 for _, axis in self.motion.sensors):
            return self.readings.nothing
        key = (effect.kind, effect.where, effect.variant)
        if key not in self._sensed:
            states = hidden.states(*np.zeros((3, len(self.position))))
            self._sensed[key] = self.readings.slopes(model, states, hidden.number)
        found = zip(self._sensed[key], moved, strict=True)
        return np.asarray(sum(slope * part[:, None] for slope, part in found))

    def _hidden(self, model: mujoco.MjModel, commands: Array) -> _Hidden:
        """Force on the one more joint of a model, and how its own motion changes all forces."""
        seen = self._dofs(model)
        number = int(np.setdiff1d(np.arange(model.nv), seen)[0])
        states = partial(_states, (self.position, self.speed, self.acceleration), seen, number)
        still, rest = states(*np.zeros((3, len(self.position)))), self._resting
        # its own spring and damper give nothing at rest: the next shape has the same forces
        if rest is None or not _same_at_rest(model, rest[0], seen):
            base = self._forces(model, commands, still)[0].copy()
            packed = model.M_rowadr[number] + model.M_rownnz[number] - 1
            rest = self._resting = model, base, self._masses(model, still[0])[:, packed]
        _, base, inertia = rest
        every = self._slopes(model, still, self._poses, [number])[0, :, 0].mean(axis=1)
        return _Hidden(
            number=number, seen=seen, states=states, force=base[:, number], inertia=inertia,
            own=every[:, number], coupled=every[:, seen],
        )  # fmt: skip

    def resonances(self, effect: Effect) -> list[tuple[float, ...]]:
        """Starts of an added spring whose ringing leaves least of the residual."""
        # All stiffnesses and dampings are tried by the joint's linear response: a lightly damped
        # spring agrees with a measurement only within some per cent of its true frequency.
        first = np.array(effect.starts[0])
        spec = self.machine.fresh()
        effect.edit(spec, first)
        model = compiled(spec)
        if model.nv != self.needed.shape[1] + 1:
            return []
        hidden = self._hidden(model, self.commands)
        inertia, damping, stiffness = hidden.own
        damping -= model.dof_damping[hidden.number]
        stiffness -= first[0]
        own, joints = effect.parameters[0], self.needed.shape[1]
        top = 2 * np.pi * self.motion.band
        high = min(own.high, inertia * (_STIFFEST * top) ** 2)
        grid = np.geomspace(own.low, max(high, 2 * own.low), _SPRINGS)
        turns, forces, left, noises = [], [], [], []
        wide = np.column_stack([hidden.force, self.residual[:, :joints]])
        for each in self.motion.split(wide):
            turn, spectrum = mirrored(each, self.motion.step)
            kept = turn <= top
            turns.append(turn[kept])
            forces.append(spectrum[kept, 0])
            left.append(spectrum[kept, 1:])
            size = np.sqrt(len(turn))
            noises.append([size * self.noise(j, turn[kept] / (2 * np.pi)) for j in range(joints)])
        turn, force = np.concatenate(turns), np.concatenate(forces)
        scale = 1 / np.concatenate(noises, axis=1).T
        channels = self.seen.mean(axis=0) > 0.5
        rest = (np.concatenate(left) * scale)[:, channels]
        powers = np.stack([turn**0, 1j * turn, -(turn**2)])
        reaction = np.einsum("pf,pj->fj", powers, hidden.coupled[::-1])[:, channels]
        reaction = reaction * scale[:, channels] * force[:, None]

        def cost(spring: float, ratio: float) -> float:
            rate = damping + 2 * ratio * np.sqrt(spring * abs(inertia))
            answer = -1 / (stiffness + spring + 1j * turn * rate - inertia * turn**2)
            off = rest - reaction * answer[:, None]
            return float(np.sum(np.log(np.mean(np.abs(off) ** 2, axis=0) + 1.0)))

        costs = np.array([[cost(k, z) for z in _DAMPINGS] for k in grid])
        best = costs.min(axis=1)
        order = [k for k in np.argsort(best) if best[k] <= best[max(k - 3, 0) : k + 4].min()]
        found = []
        for k in order[:_RESONANCES]:
            first_guess = np.log([grid[k], _DAMPINGS[int(np.argmin(costs[k]))]])
            solved = minimize(lambda x: cost(*np.exp(x)), first_guess, method="Nelder-Mead",
                              options={"maxfev": 60, "xatol": 0.01, "fatol": 0.01})  # fmt: skip
            values = [*np.exp(solved.x), *effect.starts[0][2:]]
            pairs = zip(effect.parameters, values, strict=True)
            found.append(tuple(p.clipped(float(v)) for p, v in pairs))
        return found

    def noise(self, joint: int, frequency: Array, *, floor: bool = True) -> Array:
        """Standard deviation of a channel's balance by the sensors' noise (F,)."""
        # What the operator makes of the noise of positions and speeds, beside that of the torque;
        # with a floor of rounding, which a balance that shrinks would shrink as well.
        joints = len(self.machine.joints)
        if joint >= joints:
            return self.readings.noise(joint - joints, frequency)
        torque = self.motion.noise[2]
        total = np.sum(self.noise_of(joint, frequency), axis=1) + 1e-300
        if floor:
            total = total + (_MODEL * self.machine.load_scales[joint]) ** 2
        if np.isfinite(torque[joint]) and (self.forms == "inverse").any():
            total = total + torque[joint] ** 2
        return np.asarray(np.sqrt(total))

    def noise_of(self, joint: int, frequency: Array) -> Array:
        """Variance of a joint's balance by the noise of each joint's motion (F, joints)."""
        # Where stiffness and inertia cancel, the damping is left, and by how much they vary.
        turn = 2 * np.pi * frequency[:, None]
        (mass, damping, stiffness), varied = self.operator[:, joint], self.varied[:, joint]
        gain = (stiffness - mass * turn**2) ** 2 + (damping * turn) ** 2
        gain = gain + varied[2] + varied[1] * turn**2 + varied[0] * turn**4
        return np.asarray(gain / self.motion.precision(turn[:, 0]))


def with_effects(machine: NominalModel, found: Found) -> mujoco.MjSpec:
    """Spec of a machine with some effects."""
    spec = machine.fresh()
    for effect, values in found:
        effect.edit(spec, values)
    return spec


def is_rigid(effect: Effect) -> bool:
    """Whether an effect edits rigid bodies or where they stand, in all runs alike."""
    stands = effect.part in ("link", "arm") or isinstance(effect, EncoderOffset)
    edits = stands and effect.overrides("edit")
    return edits and not (effect.adds_motion or effect.mountings)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Hidden:
    """One more joint than the machine has."""

    number: int  # Its degree of freedom
    seen: Array  # Degrees of freedom of the machine's joints (joints,)
    states: Callable[[Array, Array, Array], tuple[Array, Array, Array]]
    """States of all joints for a motion of its own."""
    force: Array  # Force on it while it rests (T,)
    inertia: Array  # Its inertia along the motion (T,)
    own: Array  # Its mean inertia, damping and stiffness (3,)
    coupled: Array
    """Change of the other joints' forces by its acceleration, speed and position (3, joints)."""


def _commanded(effect: Effect, run: RunMotion, values: Array) -> Array:
    """Commands of a run with an effect on them, as on a fine grid (T, actuators)."""
    commands = run.finer_commands
    time = np.arange(len(commands)) * run.step / FINER
    return effect.command(time, commands, values)[::FINER]


def _states(
    measured: tuple[Array, Array, Array], seen: Array, number: int, *moved: Array
) -> tuple[Array, Array, Array]:
    """Positions, speeds and accelerations of all joints, one of which moves as given."""
    whole = []
    for own, known in zip(moved, measured, strict=True):
        values = np.zeros((len(known), known.shape[1] + 1))
        values[:, seen], values[:, number] = known, own
        whole.append(values)
    return whole[0], whole[1], whole[2]


def scaled(balance: Balance) -> NominalModel:
    """Machine with the typical loads and speeds of its motion, which scale its effects' starts."""
    size = balance.drive if np.any(balance.drive) else balance.needed
    loads = np.sqrt(np.mean(size**2, axis=0))
    return NominalModel(balance.machine.spec, loads=loads, speeds=balance.usual)


_FORCES = ("body_", "jnt_", "dof_", "qpos", "tendon_", "wrap_", "site_", "actuator_", "eq_")
_NO_FORCES = ("_solref", "_solimp", "_frictionloss", "_group", "_invweight0", "_margin")


def _same_at_rest(model: mujoco.MjModel, other: mujoco.MjModel, seen: Array) -> bool:
    """Whether two models differ by springs and dampers of joints other than the seen ones alone."""
    springs = ("jnt_stiffness", "dof_damping")
    alike = (np.array_equal(getattr(model, n)[seen], getattr(other, n)[seen]) for n in springs)
    return model.nv == other.nv and all(alike) and _same_forces(model, other, without=springs)


def _same_forces(
    model: mujoco.MjModel, other: mujoco.MjModel, without: tuple[str, ...] = ()
) -> bool:
    """Whether two models need and give the same forces, dry friction and constraints apart."""
    left_out = (*_NO_FORCES, *without)
    names = [n for n in MODEL_FIELDS if n.startswith(_FORCES) and not n.endswith(left_out)]
    pairs = ((getattr(model, name), getattr(other, name)) for name in names)
    return model.opt.gravity.tolist() == other.opt.gravity.tolist() and all(
        np.array_equal(a, b, equal_nan=a.dtype.kind == "f") for a, b in pairs
    )


def _dense(model: mujoco.MjModel, packed: Array) -> Array:
    """Mass matrices (T, nv, nv) of their packed lower triangles (T, nC)."""
    rows = np.repeat(np.arange(model.nv), model.M_rownnz)
    dense = np.zeros((len(packed), model.nv, model.nv))
    dense[:, rows, model.M_colind] = dense[:, model.M_colind, rows] = packed
    return dense


def _direction(
    motion: Motion, run: RunMotion, law: tuple[str, float], usual: Array, span: Array
) -> Array:
    """Direction of sliding of a run, in the band of everything else (T, joints)."""
    # At a reversal it turns faster than the band, so it is made on a finer grid.
    kind, share = law
    if kind == "speed":
        fine = np.tanh(finer(run.speed) / (share * usual))
    else:
        fine = _dahl(finer(run.position), share * span)
    return low_passed(fine, motion.band, run.step / FINER)[::FINER]


def _dahl(position: Array, distance: Array) -> Array:
    """Dahl's direction of dry friction, which turns over a presliding distance (T, joints).

    References
    ----------
    Dahl, A solid friction model, Aerospace Corporation TOR-0158 (1968).
    """
    turned = np.diff(position, axis=0, prepend=position[:1]) / np.maximum(distance, 1e-300)
    kept, ahead = np.exp(-np.abs(turned)), np.sign(turned)
    found = np.zeros_like(position)
    for k in range(1, len(position)):
        found[k] = ahead[k] + (found[k - 1] - ahead[k]) * kept[k]
    return found
