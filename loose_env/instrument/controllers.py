"""Controllers that play a plan: presets with rates, limits, and how to log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np

from loose_env.errors import InvalidSetting, UnknownName
from loose_env.io import nearest
from loose_env.typing import Array

CommandKind = Literal["position", "velocity", "torque"]
"""Kind of command that a controller takes for every joint."""


@dataclass(frozen=True, kw_only=True)
class Controller:
    """Limits of a machine's controller, and the commands that it takes.

    A limit is one value for all joints, or one for each joint, base first.

    Examples
    --------
    >>> Controller(rate_hz=-1.0)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: rate_hz is above 0 and at most 1e5 Hz, got -1.0
    """

    commands: CommandKind = "position"
    """Kind of command: positions or velocities that the joints follow, or torques to be added."""
    rate_hz: float = 500.0
    """Rate at which the controller takes commands [Hz]."""
    bandwidth_hz: float = 20.0
    """Highest frequency at which the joints follow their commands to half their amplitude [Hz]."""
    max_speed_rad_s: tuple[float, ...] = (1.5,)
    """Largest speed [rad/s; m/s where a joint slides]."""
    max_acceleration_rad_s2: tuple[float, ...] = (15.0,)
    """Largest acceleration [rad/s²; m/s² where a joint slides]."""
    max_jerk_rad_s3: tuple[float, ...] = ()
    """Largest jerk [rad/s³; m/s³ where a joint slides]; by default none."""
    max_torque_nm: tuple[float, ...] = ()
    """Largest torque of each drive [N·m; N where it slides]; by default as the model states."""

    def __post_init__(self) -> None:
        """Check."""
        for name in ("rate_hz", "bandwidth_hz"):
            value = getattr(self, name)
            if not 0 < value <= 1e5:
                raise InvalidSetting(f"{name} is above 0 and at most 1e5 Hz, got {value!r}")
        for field in fields(self):
            values = getattr(self, field.name)
            if isinstance(values, tuple) and not all(0 < v < np.inf for v in values):
                raise InvalidSetting(
                    f"{field.name} is one positive number for all joints, or one for each, got "
                    f"{values}"
                )

    def each(self, name: str, joints: tuple[str, ...], none: Array | float = np.inf) -> Array:
        """Values of a limit, one a joint (n,); `none` where it is not stated."""
        values = getattr(self, name)
        if not values:
            return np.broadcast_to(np.asarray(none, dtype=float), len(joints)).copy()
        if len(values) not in (1, len(joints)):
            raise InvalidSetting(
                f"{name} has one value for all joints, or one for each of {', '.join(joints)}; "
                f"got {len(values)}"
            )
        return np.broadcast_to(np.array(values, dtype=float), len(joints)).copy()


@dataclass(frozen=True, kw_only=True)
class Preset:
    """A controller as its maker delivers it, with what to mind."""

    controller: Controller
    machine: str
    """What it is for."""
    log: str
    """What to log, and how."""
    code: str
    """Ten lines that play a plan and keep the log."""
    hobby: bool = False
    """True where every joint has play from the start: only a change over months is a finding."""


_UR = """\
import csv, rtde_control, rtde_receive
robot = rtde_control.RTDEControlInterface(HOST, 500.0)
state = rtde_receive.RTDEReceiveInterface(HOST, 500.0)
rows = [[float(x) for x in row] for row in list(csv.reader(open("run-01.csv")))[1:]]
robot.moveJ(rows[0][1:], 0.5, 0.5)
state.startFileRecording("robot-01.csv", ["timestamp", "actual_q", "actual_current"])
for row in rows:
    start = robot.initPeriod()
    robot.servoJ(row[1:], 0, 0, 0.002, 0.03, 2000)
    robot.waitPeriod(start)
robot.servoStop(); state.stopFileRecording()"""
_JTC = """\
ros2 bag record /joint_states /imu &           # 500 Hz: set the broadcaster's update_rate
python - <<'PY'
import csv, rclpy
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
rows = list(csv.reader(open("run-01.csv")))
goal = JointTrajectory(joint_names=[n.split(".")[1] for n in rows[0][1:]])
for row in rows[1:]:
    t, *q = map(float, row)
    stamp = rclpy.duration.Duration(seconds=t + 2.0).to_msg()
    goal.points.append(JointTrajectoryPoint(positions=q, time_from_start=stamp))
rclpy.init(); node = rclpy.create_node("shake")
topic = "/joint_trajectory_controller/joint_trajectory"
out = node.create_publisher(JointTrajectory, topic, 1)
while not out.get_subscription_count(): rclpy.spin_once(node, timeout_sec=0.1)
out.publish(goal); rclpy.spin_once(node, timeout_sec=1.0)
PY"""
_RSI = """\
# RSI context: ETHERNET -> POSCORR, or AXISCORR in absolute mode, cycle 4 ms (IPO_FAST)
import csv, re, socket
rows = [list(map(float, r)) for r in list(csv.reader(open("run-01.csv")))[1:]]
port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); port.bind(("", 49152))
log = open("robot-01.csv", "w")
for row in rows:                                # one answer to each packet, within 4 ms
    text, peer = port.recvfrom(4096); count = re.search(rb"<IPOC>(\\d+)", text)[1].decode()
    log.write(f"{count},{text.decode()!r}\\n")
    axes = " ".join(f'A{k}="{57.29578 * (q - q0):.5f}"'
                    for k, (q, q0) in enumerate(zip(row[1:], rows[0][1:]), 1))
    port.sendto(f'<Sen Type="ImFree"><AK {axes}/><IPOC>{count}</IPOC></Sen>'.encode(), peer)"""
_FCI = """\
# pylibfranka, joint position interface; commands pass its own low-pass filter
import csv, pylibfranka as fci
rows = [list(map(float, r)) for r in list(csv.reader(open("run-01.csv")))[1:]]
robot = fci.Robot(HOST); log = csv.writer(open("robot-01.csv", "w"))
control = robot.start_joint_position_control(fci.ControllerMode.JointImpedance)
for k, row in enumerate(rows):                  # 1 kHz
    state, _ = control.readOnce()
    log.writerow([state.time.to_sec(), *state.q, *state.tau_J])
    command = fci.JointPositions(row[1:]); command.motion_finished = k == len(rows) - 1
    control.writeOnce(command)"""
_FANUC = """\
# Stream motion (option J519): one UDP packet each 8 ms (or 4), joints in degrees
import csv, socket, struct
rows = [list(map(float, r)) for r in list(csv.reader(open("run-01.csv")))[1:]]
port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); port.sendto(START, (HOST, 60015))
log = open("robot-01.bin", "wb")
for k, row in enumerate(rows):
    log.write(port.recv(512))
    last = k == len(rows) - 1
    degrees = [57.29578 * q for q in row[1:]] + [0.0] * (10 - len(row))
    port.sendto(struct.pack(">IIIBBHHBBHHH9f", 1, 1, k, last, 0, 0, 0, 0, 1, 0, 0, 0,
                            *degrees[:9]), (HOST, 60015))"""
_VELOCITY = """\
import csv, time
rows = [list(map(float, r)) for r in list(csv.reader(open("run-01.csv")))[1:]]
log = csv.writer(open("robot-01.csv", "w")); start = time.perf_counter()
for row in rows:
    while time.perf_counter() - start < row[0]: pass
    drives.write_velocity(row[1:])               # rad/s, your fieldbus
    log.writerow([time.perf_counter() - start, *drives.read_position(), *drives.read_torque()])
drives.write_velocity([0.0] * (len(row) - 1))"""
_HOBBY = """\
import csv, time
from lerobot.robots import make_robot_from_config
rows = [list(map(float, r)) for r in list(csv.reader(open("run-01.csv")))[1:]]
robot = make_robot_from_config(CONFIG); robot.connect()
log = csv.writer(open("robot-01.csv", "w")); start = time.perf_counter()
for row in rows:
    while time.perf_counter() - start < row[0]: pass
    action = {f"{m}.pos": 57.29578 * q for m, q in zip(robot.bus.motors, row[1:])}
    robot.send_action(action); seen = robot.get_observation()
    log.writerow([time.perf_counter() - start, *(seen[name] for name in action)])"""
_PLC = """\
# Load run-01.csv into the PLC's table (cam profile, or a trace of set points), one row a cycle.
# Trace with the same cycle: time, actual positions, torques of all axes; export as CSV.
# Structured text, in the cyclic task:
#   IF running THEN
#     FOR axis := 1 TO N DO MC_Setpoint[axis].Position := Table[row, axis]; END_FOR
#     row := row + 1; running := row <= ROWS;
#   END_IF"""

PRESETS: Mapping[str, Preset] = {
    "ur_rtde": Preset(
        controller=Controller(
            rate_hz=500, bandwidth_hz=25, max_speed_rad_s=(1.5,), max_acceleration_rad_s2=(15.0,)
        ),
        machine="Universal Robots, servoJ over RTDE",
        log="actual_q and actual_current at 500 Hz (e-Series)",
        code=_UR,
    ),
    "ros2_jtc": Preset(
        controller=Controller(
            rate_hz=200, bandwidth_hz=20, max_speed_rad_s=(1.5,), max_acceleration_rad_s2=(10.0,)
        ),
        machine="ros2_control, joint_trajectory_controller",
        log="/joint_states at the update rate, 250 Hz at least; set path tolerances to 0",
        code=_JTC,
    ),
    "kuka_rsi": Preset(
        controller=Controller(
            rate_hz=250, bandwidth_hz=15, max_speed_rad_s=(1.5,), max_acceleration_rad_s2=(10.0,)
        ),
        machine="KUKA, Robot Sensor Interface",
        log="AIPos and MACur of each packet, every 4 ms",
        code=_RSI,
    ),
    "franka_fci": Preset(
        controller=Controller(
            rate_hz=1000,
            bandwidth_hz=20,
            max_speed_rad_s=(2.0,),
            max_acceleration_rad_s2=(10.0,),
            max_jerk_rad_s3=(4000.0,),
        ),
        machine="Franka Research 3, libfranka",
        log="q and tau_J at 1 kHz",
        code=_FCI,
    ),
    "fanuc_stream": Preset(
        controller=Controller(
            rate_hz=125, bandwidth_hz=12, max_speed_rad_s=(1.5,), max_acceleration_rad_s2=(8.0,)
        ),
        machine="FANUC, stream motion",
        log="joint angles and currents of each status packet, every 8 or 4 ms",
        code=_FANUC,
    ),
    "velocity_drive": Preset(
        controller=Controller(
            commands="velocity",
            rate_hz=500,
            bandwidth_hz=25,
            max_speed_rad_s=(1.5,),
            max_acceleration_rad_s2=(15.0,),
        ),
        machine="drives with velocity commands on a fieldbus",
        log="position and torque of every drive with each command",
        code=_VELOCITY,
    ),
    "hobby_servo": Preset(
        controller=Controller(
            rate_hz=50, bandwidth_hz=11, max_speed_rad_s=(3.0,), max_acceleration_rad_s2=(25.0,)
        ),
        machine="desk arms with serial bus servos (Feetech, Dynamixel)",
        log="positions with each command, 50 Hz at least",
        code=_HOBBY,
        hobby=True,
    ),
    "plc_csv": Preset(
        controller=Controller(
            rate_hz=250, bandwidth_hz=20, max_speed_rad_s=(1.0,), max_acceleration_rad_s2=(10.0,)
        ),
        machine="gantries, SCARAs and palletisers on a PLC, by a table of set points",
        log="trace of positions and torques in the task's cycle",
        code=_PLC,
    ),
}
"""Name -> preset. Figures are starting points on the safe side: a sweep measures the real
bandwidth."""


def preset(name: str) -> Preset:
    """Preset of a name.

    Raises
    ------
    UnknownName
        If there is none.

    Examples
    --------
    >>> preset("ur_rtd")
    Traceback (most recent call last):
    ...
    loose_env.errors.UnknownName: there is no controller 'ur_rtd'; did you mean 'ur_rtde'? ...
    """
    if name not in PRESETS:
        meant = nearest(name, list(PRESETS)) or "."
        raise UnknownName(
            f"there is no controller {name!r}{meant} The controllers are {', '.join(PRESETS)}"
        )
    return PRESETS[name]


def adjusted(controller: Controller, **given: object) -> Controller:
    """Controller with what the user states; None and () leave the preset's value."""
    stated = {name: value for name, value in given.items() if value not in (None, ())}
    return replace(controller, **stated)  # type: ignore[arg-type]
