"""Settings, and tolerances of a nominal model: what a user's model never has exactly.

Nuisances are fitted with every hypothesis, each with a Gaussian prior of the width that stands
here, and are never reported. An effect is named only where the data pull it clearly out of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from math import nan, sqrt
from typing import Annotated, Any

import mujoco
import numpy as np
from annotated_types import Ge, Le

from loose_env.gap.core.balance import USUAL, Balance, Change, Found, with_effects
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.inertia import LinkMass, links_with_mass
from loose_env.gap.model.effects.joints import RotorInertia, TorqueOffset
from loose_env.gap.model.effects.mjcf import Inertial, inertial_of, set_inertial
from loose_env.gap.model.effects.sensors import EncoderOffset, SensorBias, SensorDelay
from loose_env.gap.model.hypothesis import scale
from loose_env.gap.model.nominal_model import NominalModel, link_ends
from loose_env.io import Checked, Positive, Rule, check_fields
from loose_env.typing import Array

Edit = Callable[[mujoco.MjSpec, float], None]
"""Changes a spec by a number of standard deviations."""


@dataclass(frozen=True, kw_only=True)
class Tolerances(Checked):
    """Standard deviations of what a nominal model states."""

    mass: Positive = 0.025
    """Mass of a link, with its inertia [share]: CAD against a weighed part."""
    centre: Positive = 0.02
    """Centre of mass of a link [share of its length], at most `centre_m`: cables, screws."""
    centre_m: Positive = 0.01
    """Largest tolerance of a centre of mass [m]."""
    inertia: Positive = 0.1
    """Each of the six components of a link's inertia [share of its mean moment]."""
    armature: Positive = 0.1
    """Rotor inertia [share]: data sheets round, and gears add."""
    torque: Positive = 0.025
    """Torque constant, or gain of a servo [share]."""
    velocity_gain: Positive = 0.06
    """Velocity gain of a servo [share]: the same column as viscous friction."""
    speed_feedback_s: Positive = 0.002
    """Time by which the speed is late that a servo feeds back [s]: two cycles of 1 ms, for a speed
    is a difference of filtered positions; no later than a stable loop bears."""
    damping: Positive = 0.06
    """Damping and dry friction that the model has [share]: they change with temperature."""
    offset: Positive = 0.01
    """Constant torque of a joint [share of its typical torque]."""
    offset_of_limit: Positive = 0.003
    """The same as a share of the largest torque that the drive is built for, if that is more."""
    zero: Positive = 0.001
    """Zero position of a joint [rad, m]: a calibrated encoder."""
    shift_samples: Positive = 0.4
    """Shift of commands or torques against the motion [intervals of the log], of either sign:
    held or interpolated commands, and the order of a logger's cycle."""
    law: Positive = 0.05
    """Force of an effect of a joint or a drive that its law misses [share of it]: oil thins with
    speed, springs stiffen, friction warms."""
    sensor: Positive = 0.005
    """Gain of a velocity or inertial sensor [share], and each angle of its axes [rad]."""
    sensor_bias: Positive = 0.01
    """Constant of such a reading [share of its root mean square]."""
    sensor_samples: Positive = 0.7
    """Shift of their readings against the positions [intervals of the log]."""


@dataclass(frozen=True, kw_only=True)
class GapSettings:
    """Settings of the comparison of a recording with its model.

    Examples
    --------
    >>> GapSettings(threads=-1)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: GapSettings.threads must be a whole number, 0 to 10000; got -1
    """

    kinds: tuple[str, ...] = ()
    """Kinds of effect that are considered, such as coulomb_friction; by default the whole
    catalogue."""
    held_out: tuple[str, ...] = ()
    """Runs kept out of everything and predicted at the end: their files, or the beginning of their
    names. By default every run is held out once, in turn."""
    simulate: bool = True
    """Whether full simulation decides where the force balance leaves most of a joint open and there
    are commands; without it the balance alone decides, in a fraction of the time."""
    threads: Annotated[int, Rule("a whole number, 0 to 10000", (Ge(0), Le(10_000)))] = 0
    """Threads of the simulation; 0 for all processors."""
    tolerances: Tolerances = field(default_factory=Tolerances)
    """Standard deviations of what the nominal model states."""

    def __post_init__(self) -> None:
        """Check the values."""
        check_fields(self, GapSettings)  # a command line has more


@dataclass(frozen=True, kw_only=True, eq=False)
class Nuisance:
    """One tolerance: the change of the balance by one standard deviation."""

    name: str  # Name for the reader
    change: Change  # Change of the balance (T, joints)
    operator: Array  # Change of the mean inertia, damping and stiffness (3, joints, joints)
    edit: Edit | None = None
    """Edit of a spec by a number of standard deviations; None if no model has it."""
    scaled: tuple[int, float] | None = None
    """Joint whose measured torque is scaled, and by how much; `change` has the nominal part."""
    late: tuple[int, float] | None = None
    """Actuator whose commands are shifted, and by how much [s]."""
    read_late: tuple[int, float] | None = None
    """Joint whose position is read late, and by how much [s]."""
    of_commands: bool = False
    """Whether the change is made of commands, which have no noise, not of the measured motion."""
    size: float = nan  # One standard deviation; NaN of what has no size that one could look up
    unit: str = ""  # Its unit


_STABLE = 0.2
"""Lateness of a speed times the crossover of its loop, velocity gain over inertia, at most [rad]: a
phase lag of 11 degrees, which a loop with the usual margin of 60 can spare."""
_STEP = 1e-3  # relative step of numerical derivatives


def nuisances(balance: Balance, tolerances: Tolerances) -> list[Nuisance]:
    """List the tolerances of a model that its recording can depend on."""
    # Those of rigid bodies beside the effects that were found.
    return [
        *_rigid(balance, tolerances),
        *_joints(balance, tolerances),
        *_drives(balance, tolerances),
        *_sensors(balance, tolerances),
    ]


def missed_by_laws(balance: Balance, forces: Mapping[str, Array]) -> list[Nuisance]:
    """What the laws of effects miss, such forces (T, channels) in turn with the motion."""
    # Springs stiffen, friction differs from place to place, oil thins with speed, gears warm.
    time = np.arange(len(balance.position))[:, None] + 0 * balance.position
    place, found = _even(balance.position), list[Nuisance]()
    shapes = {"slope": place, "bend": _even(place**2), "thinning": _even(np.abs(balance.speed))}
    shapes["drift"], nothing = _even(time), np.zeros_like(balance.operator)
    for name, force in forces.items():
        for what, shape in shapes.items():
            change = np.zeros_like(force)
            change[:, : shape.shape[1]] = force[:, : shape.shape[1]] * shape / sqrt(len(shapes))
            found.append(
                Nuisance(name=f"{what} of {name}", change=Change(change), operator=nothing)
            )
    return found


def _even(values: Array) -> Array:
    """Values of mean zero and unit variance, joint by joint."""
    return np.asarray((values - values.mean(0)) / np.maximum(values.std(0), 1e-12))


def together(balance: Balance) -> Array | float:
    """Change of the balance by the effects found, beyond the sum of each beside the others."""
    # (T, channels); of a centre that is off, a tilted base turns the moment.
    found = balance.found
    if len(found) < 2:
        return 0.0
    rests = [tuple(own for own in found if own is not left) for left in found]
    direction = balance.directions[USUAL]
    whole, *others = (
        balance.folded(balance.known(own).with_contact(direction)) for own in (found, *rests)
    )
    return np.asarray(whole - sum(whole - other for other in others))


def _edited(
    name: str, edit: Edit, size: float, unit: str, balance: Balance, found: Found = ()
) -> Nuisance:
    """Tolerance that an edit of the spec describes, less what effects beside it change."""
    spec = with_effects(balance.machine, found)
    edit(spec, _STEP)
    forces = balance.edited(spec)
    if found:
        forces = forces.less(balance.known(found))
    change = forces.with_contact(balance.directions[USUAL])
    return Nuisance(
        name=name, change=balance.change(change / _STEP), operator=forces.operator / _STEP,
        edit=edit, size=size, unit=unit,
    )  # fmt: skip


def _shift(name: str, change: Array, balance: Balance, **more: Any) -> Nuisance:
    """Tolerance that leaves the mean inertia, damping and stiffness as they are."""
    nothing = np.zeros_like(balance.operator)
    return Nuisance(name=name, change=balance.change(change), operator=nothing, **more)


def _rigid(balance: Balance, tolerances: Tolerances) -> Iterator[Nuisance]:
    """Ten rigid parameters of each link."""
    machine, found = balance.machine, balance.found
    for link in links_with_mass(machine):
        own = float(machine.model.body(link).mass[0])
        size = _size(machine, link)
        heavier = _sized(LinkMass(machine, link), tolerances.mass * own)
        yield _edited(f"mass of {link}", heavier, tolerances.mass * own, "kg", balance, found)
        width = min(tolerances.centre * size, tolerances.centre_m)
        for k, axis in enumerate("xyz"):
            shift = _inertial(machine, link, width * np.eye(3)[k], np.zeros((3, 3)))
            yield _edited(f"centre of {link} along {axis}", shift, width, "m", balance, found)
        moment = float(np.mean(machine.model.body(link).inertia)) + 1e-3 * own * size**2
        for row, column in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
            tensor = np.zeros((3, 3))
            tensor[row, column] = tensor[column, row] = tolerances.inertia * moment
            turned = _inertial(machine, link, np.zeros(3), tensor)
            name, size = f"inertia {'xyz'[row]}{'xyz'[column]} of {link}", tensor[row, column]
            yield _edited(name, turned, size, "kg·m²", balance, found)


def _sized(effect: Effect, width: float) -> Edit:
    """Edit of an effect of one parameter, of such a width."""
    return lambda spec, deviations: effect.edit(spec, np.array([deviations * width]))


def _inertial(machine: NominalModel, link: str, centre: Array, tensor: Array) -> Edit:
    """Edit that shifts a link's centre and changes its inertia."""

    def edit(spec: mujoco.MjSpec, deviations: float) -> None:
        old = inertial_of(machine, spec, link)
        changed = Inertial(
            old.mass, old.centre + deviations * centre, old.tensor + deviations * tensor
        )
        set_inertial(machine, spec, link, changed)

    return edit


def _size(machine: NominalModel, link: str) -> float:
    """Length of a link: between its joints, or what its inertia and centre say [m]."""
    start, end = link_ends(machine, link)
    body = machine.model.body(link)
    gyration = 2 * np.sqrt(np.sum(body.inertia) / 2 / body.mass[0])
    return float(max(np.linalg.norm(end - start), gyration, np.linalg.norm(body.ipos)))


def _joints(balance: Balance, tolerances: Tolerances) -> Iterator[Nuisance]:
    """Zero positions, rotor inertias, dampings, constant torques and shifts of torque readings."""
    machine, model = balance.machine, balance.machine.model
    for joint, name in enumerate(machine.joints):
        offset = EncoderOffset(machine, name)
        shifted, unit = _sized(offset, tolerances.zero), offset.angle_unit
        yield _edited(f"zero of {name}", shifted, tolerances.zero, unit, balance, balance.found)
        for part, width in (
            ("armature", tolerances.armature),
            ("damping", tolerances.damping),
            ("frictionloss", tolerances.damping),
        ):
            if float(getattr(model, f"dof_{part}")[int(model.joint(name).dofadr[0])]) > 0:
                scaled = _scaled(part, name, width)
                yield _edited(f"{part} of {name}", scaled, 100 * width, "%", balance)
        one = np.eye(len(machine.joints))[joint]
        largest = float(machine.torque_limits[joint])
        size = tolerances.offset * float(machine.load_scales[joint])
        size = max(size, tolerances.offset_of_limit * (largest if np.isfinite(largest) else 0.0))
        change = np.tile(size * one, (len(balance.drive), 1))
        constant = _sized(TorqueOffset(machine, name), size)
        yield _shift(
            f"constant torque at {name}", change, balance, edit=constant, size=-size,
            unit=offset.torque_unit,
        )  # fmt: skip
        inverse = (balance.forms == "inverse") & balance.seen[:, joint]
        if inverse.any():
            gain = np.where(inverse, balance.needed[:, joint], 0.0)[:, None] * one
            width = tolerances.torque
            yield Nuisance(
                name=f"torque constant of {name}", change=balance.change(width * gain),
                operator=width * balance.operator * one[:, None], scaled=(joint, width),
                size=100 * width, unit="%",
            )  # fmt: skip
            log_step = balance.motion.runs[0].log_step
            # of the smear not of the reading: its noise would be smeared as well
            for order, what, force in ((1, "delay", -balance.drive), (2, "smear", balance.needed)):
                rate = balance.motion.rates(force[:, joint], order)
                width = (tolerances.shift_samples * log_step) ** order / order
                change = np.where(inverse, np.nan_to_num(rate), 0.0)[:, None] * one
                seen = {"size": width, "unit": "s"} if order == 1 else {}
                yield _shift(f"{what} of the torque of {name}", width * change, balance, **seen)


def _scaled(name: str, of: str, width: float) -> Edit:
    """Edit that scales a property of a joint or the gains of a drive."""
    return lambda spec, deviations: scale(spec, name, of, max(1 + deviations * width, 0.0))


def _late_speed(balance: Balance, actuator: str, late: float) -> tuple[Edit, float]:
    """Edit that feeds a speed back late, and by how much [s]."""
    # it takes the velocity gain times that off the inertia
    machine = balance.machine
    model, joint = machine.model, machine.actuated_joint[actuator]
    own, number = model.actuator(actuator), machine.joint_number(joint)
    gain = abs(float(own.biasprm[2])) * float(own.gear[0]) ** 2
    # later, it would swing
    late = min(late, _STABLE * float(balance.operator[0, number, number]) / gain)
    return _sized(RotorInertia(machine, joint), -late * gain), late


def _drives(balance: Balance, tolerances: Tolerances) -> Iterator[Nuisance]:
    """Gains and command shifts of the actuators."""
    machine = balance.machine
    if balance.released.all():
        return
    for number, name in enumerate(machine.actuators):
        if machine.affine_actuators[number]:
            gain = _scaled("all_gains", name, tolerances.torque)
            yield _edited(f"gain of {name}", gain, 100 * tolerances.torque, "%", balance)
            if machine.model.actuator_biasprm[number, 2] != 0 and name in machine.actuated_joint:
                width = tolerances.velocity_gain
                rate = _scaled("velocity_gain", name, width)
                yield _edited(f"velocity gain of {name}", rate, 100 * width, "%", balance)
                late = _late_speed(balance, name, tolerances.speed_feedback_s)
                yield _edited(f"delay of the speed feedback of {name}", *late, "s", balance)
        width = tolerances.shift_samples * balance.motion.runs[0].log_step
        change = width * balance.late(number, 1)
        yield _shift(
            f"delay of the commands of {name}", change, balance, late=(number, width),
            size=width, unit="s",
        )  # fmt: skip
        change = -(width**2) / 2 * balance.late(number, 2)
        yield _shift(f"smear of the commands of {name}", change, balance)


def _between_samples(balance: Balance) -> Iterator[Nuisance]:
    """Motion at samples beyond its mean between them, as commands step or bend near them."""
    # Each joint gives way by an inertia of its own, which an effect may change; a speed feels
    # hardly more than its own drive's.
    motion, joints, readings = balance.motion, len(balance.machine.joints), balance.readings
    if not readings.names:
        return
    step = motion.runs[0].log_step
    pairs = zip(balance.machine.actuators, balance.at_samples(), strict=True)
    for name, (steps, bends) in pairs:
        # between two steps a sawtooth of acceleration is a parabola of speed, lowest at them
        beyond = [("steps", steps, -step / 6 * steps)]
        if readings.accelerated():
            slopes = step * motion.rates(bends)
            beyond += [("bends", bends, 0 * bends), ("shift of bends", slopes, 0 * bends)]
        for what, more, faster in beyond:
            seen = [
                readings.turned(k, [0 * v, v, a])
                for k, (v, a) in enumerate(zip(faster.T, more.T, strict=True))
            ]
            for part in seen if readings.accelerated() else [np.sum(seen, axis=0)]:
                change = np.hstack([np.zeros((len(part), joints)), part])
                yield _shift(
                    f"{what} of {name} in readings", change, balance, of_commands=True
                )  # fmt: skip


def _sensors(balance: Balance, tolerances: Tolerances) -> Iterator[Nuisance]:
    """Gain, alignment and timing of velocity and inertial sensors."""
    motion, joints = balance.motion, len(balance.machine.joints)
    foretold = balance.readings.foretold
    if not balance.released.all():
        yield from _between_samples(balance)
    step = motion.runs[0].log_step
    for name, joint in balance.encoders.items():
        forces = balance.forces(SensorDelay(balance.machine, name), np.array([0.1 * step]))
        change = 10 * tolerances.sensor_samples * np.hstack([forces.smooth, forces.readings])
        size = tolerances.sensor_samples * step
        yield _shift(
            f"delay of {name}", change, balance, read_late=(joint, size), size=size, unit="s"
        )
    for name, at in balance.readings.sensors:
        shown = foretold[:, at]
        late, smeared = (motion.rates(shown, order) for order in (1, 2))
        size = float(np.sqrt(np.mean(shown**2)))
        width = tolerances.sensor_samples * step
        bias, gain = tolerances.sensor_bias * size, tolerances.sensor
        unit = SensorBias(balance.machine, name).parameters[0].unit
        changes = [("delay", -width * late, width, "s"), ("smear", width**2 / 2 * smeared, nan, "")]
        changes += [("gain", gain * shown, 100 * gain, "%")]
        axes = np.eye(len(at))
        changes += [("zero", bias * axis + 0 * shown, bias, unit) for axis in axes]
        if len(at) == 3:
            turned = (np.cross(shown, axis) for axis in axes)
            changes += [("alignment", gain * each, gain, "rad") for each in turned]
        for what, own, wide, unit in changes:
            change = np.zeros((len(foretold), joints + len(motion.sensors)))
            change[:, joints + np.array(at)] = own
            yield _shift(f"{what} of {name}", change, balance, size=wide, unit=unit)
