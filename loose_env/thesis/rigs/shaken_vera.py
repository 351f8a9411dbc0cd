"""VERA as Experiments Five and Six had it: a shaker on link 1, a pin in joint 2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from loose_env.arms import LINK_LENGTH, Arm, BendingLink2, Holding, Shaker, holdings, vera_spec
from loose_env.errors import InvalidSetting, UnknownName

Pin = Literal["engaged", "half_released", "rigid"]
STIFF_PIN_FACTOR = 20.0
"""Stiffness of the rigid pin over that of the engaged one: its mode then lies above the band."""

PROXIMAL = "link1_accelerometer"
"""Probe on link 1; its second axis is tangential and gives the reference of all correlations."""
SHAKEN_BAND = (20.0, 350.0)
"""White noise played to the shaker [Hz] (6.1.6: flat to 350 Hz)."""


@dataclass(frozen=True, kw_only=True)
class ShakenVeraParameters:
    """Parameters of the rig that the thesis does not print, one set for all cases.

    The defaults were identified by ``scripts/studies/thesis/identify_shaken_vera.py`` from the
    printed directions and magnitudes of the five healthy cases together: twelve parameters from ten
    numbers, so that agreement with these ten is no evidence for any single value.
    """

    pin_stiffness: float = 7.04e4
    """Torsional stiffness of the tapered pin between gear and link 1 [N·m/rad]."""
    pin_damping: float = 9.14
    """Its damping [N·m·s/rad]."""
    link2_mode: float = 251.0
    """First bending mode of link 2, clamped [Hz]; the thesis says over 200 Hz (6.1.2)."""
    link2_damping: float = 0.015
    """Damping ratio of that mode."""
    link1_damping: float = 0.0906
    """Damping ratio of link 1's bending mode, with cables and hitch attached."""
    seat_mass: float = 0.537
    """Mass of the looseness joint at the proximal end of link 2 [kg]."""
    joint_damping: float = 1.26
    """Damping of joint 1, whose drive is turned backwards [N·m·s/rad]."""
    hitch: float = 0.160
    """Distance of the stinger from joint 1 [m]."""
    accelerometer: float = 0.167
    """Distance of link 1's accelerometer from joint 1 [m]."""
    coil_mass: float = 0.805
    """Coil and table of the shaker [kg]."""
    suspension_stiffness: float = 2.29e5
    """Suspension of the coil [N/m]."""
    suspension_damping: float = 136.0
    """Its damping [N·s/m]."""

    def __post_init__(self) -> None:
        for name in ("hitch", "accelerometer"):
            value = getattr(self, name)
            if not LINK_LENGTH / 3 <= value <= LINK_LENGTH:
                raise InvalidSetting(
                    f"{name} lies on the outer two thirds of link 1, "
                    f"{LINK_LENGTH / 3:.3f} to {LINK_LENGTH:.2f} m from joint 1; got {value!r}"
                )


STIFF_PIN_FIT = ShakenVeraParameters(
    pin_stiffness=1.41e6,
    pin_damping=40.9,
    link2_mode=207.0,
    link2_damping=0.0108,
    link1_damping=0.0428,
    seat_mass=0.406,
    joint_damping=3.24,
    hitch=0.187,
    accelerometer=0.179,
    coil_mass=3.46,
    suspension_stiffness=4.99e4,
    suspension_damping=369.0,
)
"""The same fit with the pin held at `STIFF_PIN_FACTOR` times its stiffness and damped alike
(``identify_shaken_vera.py --stiff-pin``): the rival explanation of the healthy cases."""
STINGER_STIFFNESS, STINGER_DAMPING, STINGER_LENGTH = 1.56e7, 50.0, 0.17
"""The threaded rod between shaker and link (6.12) [N/m, N·s/m, m]."""


def shaken_vera(*, pin: Pin = "engaged", parameters: ShakenVeraParameters | None = None) -> Arm:
    """Build VERA on the shaker: link 1 is pushed, joint 2 is blocked by a pin.

    Both bending modes are in the model, since the band reaches 350 Hz, and so is the
    compliance of the pin. Joint 2 is excited by nobody; joint 1 is free while the shaker runs.

    Parameters
    ----------
    pin : {"engaged", "half_released", "rigid"}
        The pin of joint 2: as in the experiments, drawn out until half of its stiffness is
        left (6.5.3), or twenty times as stiff.
    parameters : ShakenVeraParameters, optional
        Parameters of the rig.

    Raises
    ------
    UnknownName
        If there is no such pin.

    Examples
    --------
    >>> arm = shaken_vera()
    >>> arm.probes, arm.shaker.joint
    (('link1_accelerometer',), 1)
    """
    stiffness = {"engaged": 1.0, "half_released": 0.5, "rigid": STIFF_PIN_FACTOR}
    if pin not in stiffness:
        raise UnknownName(f"unknown pin {pin!r}: {', '.join(map(repr, stiffness))}")
    rig = ShakenVeraParameters() if parameters is None else parameters
    spec = vera_spec(
        mode_damping=rig.link1_damping,
        link2=BendingLink2(
            mode_hz=rig.link2_mode, damping=rig.link2_damping, seat_mass=rig.seat_mass
        ),
    )
    root = LINK_LENGTH / 3
    # The accelerometer lies beyond the bending hinge, as the beam there does bend.
    spec.body("link1_end").add_site(name=PROXIMAL, pos=[rig.accelerometer - root, 0, 0])
    joints = ("joint1", "joint2")
    brake, servo, centring = holdings(spec, joints)
    factor = stiffness[pin]
    pinned = Holding(
        stiffness=(brake.stiffness[0], rig.pin_stiffness * factor),
        damping=(brake.damping[0], rig.pin_damping * factor**0.5),
    )
    # Joint 1 turns freely; the suspension of the coil centres it.
    centring = Holding(
        stiffness=(0.0, centring.stiffness[1]), damping=(rig.joint_damping, centring.damping[1])
    )
    return Arm(
        name="vera-shaken" if pin == "engaged" else f"vera-shaken-{pin.replace('_', '-')}",
        spec=spec,
        joints=joints,
        seat_bodies=("link1", "link2"),
        tool="tool",
        axes=(0, 1),
        torque_limits=(5.08, 3.39),
        joint_ranges=(None, None),
        levels=(1.0, 3.0, 9.0),
        band=SHAKEN_BAND,
        brake=pinned,
        servo=servo,
        centring=centring,
        timestep=1e-4,
        settling=0.3,
        probes=(PROXIMAL,),
        shaker=Shaker(
            joint=1,
            body="link1_end",
            point=(rig.hitch - root, 0.0, 0.0),
            direction=(0.0, 1.0, 0.0),
            coil_mass=rig.coil_mass,
            stinger_stiffness=STINGER_STIFFNESS,
            stinger_damping=STINGER_DAMPING,
            stinger_length=STINGER_LENGTH,
            suspension_stiffness=rig.suspension_stiffness,
            suspension_damping=rig.suspension_damping,
        ),
    )
