"""Settings of the arm that the model file lacks, and of the layout of a plan's signal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from loose_env.errors import InvalidSetting
from loose_env.instrument.settings.validation import check_types

_MOST_REPEATS = 20
_MOST_FORCE_N = 1e6
Hold = Literal["model", "brake", "servo", "compliant"]
"""Holding of joints: by the model's actuators, or one of `loose_env.arms.HoldKind`."""

ExcitationKind = Literal["joint", "hammer", "shaker"]
"""Excitation by a joint's drive, or of the tool by a hammer or shaker with a force sensor."""


@dataclass(frozen=True, kw_only=True)
class ModelSettings:
    """Properties of the arm that the model file lacks."""

    tool: str | None = None
    """Site or body that carries the accelerometer; by default where the model's own accelerometer
    is, else the site 'tool', else the last site or body."""
    hold: Hold = "model"
    """Holding of the joints: 'model', the model's own position servos, and a slow controller for
    joints with torque motors, as 'loose diagnose' assumes; or 'brake', 'servo',
    'compliant' for brakes, servos of 25 Hz, or brakes behind elastic gears."""
    package_path: str | None = None
    """Folder of the ROS package, or of several, in which the meshes of a URDF lie (package://name/
    and paths with ../); by default the folder above the URDF that holds a package.xml."""
    payload_kg: float = 0.0
    """Mass at the tool that the model lacks [kg]."""
    payload_at_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Its centre in the tool frame, x y z [m]."""
    excitation: ExcitationKind = "joint"
    """Excitation: 'joint', by the drive of a joint; 'hammer' or 'shaker', of the tool, with its
    measured force, where a controller cannot shake."""

    def __post_init__(self) -> None:
        """Check."""
        check_types(self)
        if self.payload_kg < 0:
            raise InvalidSetting(
                f"payload_kg is a mass of zero or more kg, got {self.payload_kg!r}"
            )
        if len(self.payload_at_m) != 3:
            raise InvalidSetting(
                "payload_at_m is three finite numbers in the tool frame [m], got "
                f"{self.payload_at_m!r}"
            )


@dataclass(frozen=True, kw_only=True)
class PlanSettings:
    """Layout of the signal, and choices that the user fixes."""

    joint: str | None = None
    """Joint to excite; by default the one that tells most."""
    pose_deg: tuple[float, ...] = ()
    """Pose to take, every joint from the base [degrees; mm where it slides]; by default the one
    that tells most."""
    from_deg: tuple[float, ...] = ()
    """Present pose, as pose_deg; by default in the pose of the last record."""
    ramp_s: float = 0.25
    """Time over which the noise swells, and dies away [s]."""
    hold_s: float = 0.5
    """Time before and after [s]: commands go from the pose to what holds the arm's weight in it,
    and the arm stands still."""
    repeat: int = 1
    """Number of times that the session's first run is repeated at the end: its drift and scatter
    are those of machine and sensors; 0 for none."""
    reference: bool = False
    """Plan the same runs for the healthy machine too: with them faults are found by the difference
    of two measurements, without the errors of the model."""
    force_n: float = 20.0
    """Rms force of a hammer or shaker on the tool while it acts [N]."""

    def __post_init__(self) -> None:
        """Check."""
        check_types(self)
        for name in ("ramp_s", "hold_s"):
            value = getattr(self, name)
            if not 0 <= value <= 60:
                raise InvalidSetting(f"{name} is 0 to 60 s, got {value!r}")
        if not 0 < self.force_n <= _MOST_FORCE_N:
            raise InvalidSetting(
                f"force_n is above 0 and at most {_MOST_FORCE_N:g} N, got {self.force_n!r}"
            )
        if not 0 <= self.repeat <= _MOST_REPEATS:
            raise InvalidSetting(
                f"repeat is a whole number from 0 to {_MOST_REPEATS}, got {self.repeat}"
            )
