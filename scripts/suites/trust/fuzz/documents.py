"""Whole, small documents of every kind that is read: what is damaged afterwards."""

from __future__ import annotations

import functools
import io
import json
import struct
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.arms import DESK_ARM

__all__ = [
    "MAPPING",
    "MODEL",
    "PLACES",
    "URDF",
    "WEIGHTS",
    "arm_text",
    "diagnosis_result",
    "gap_result",
    "log_mapping",
    "logs",
    "plan",
    "recording",
    "rows",
    "shaken",
    "tetrahedron",
]

WEIGHTS = Path(__file__).resolve().parents[4] / "agents" / "loose_agents" / "weights"
MODEL = """<mujoco model="small">
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <asset><texture name="t" type="2d" builtin="flat" width="8" height="8"/></asset>
  <worldbody>
    <body name="upper">
      <joint name="turn" axis="0 0 1" range="-2 2" actuatorfrcrange="-20 20" armature="0.1"/>
      <inertial pos=".2 0 0" mass="2" diaginertia=".02 .02 .02"/>
      <body name="lower" pos=".4 0 0">
        <joint name="bend" axis="0 1 0" range="-2 2" actuatorfrcrange="-10 10" armature="0.1"/>
        <inertial pos=".1 0 0" mass="1" diaginertia=".01 .01 .01"/>
        <geom type="box" size=".1 .02 .02" mass="0"/>
        <site name="tool" pos=".2 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="m1" joint="turn"/><position name="m2" joint="bend" kp="100"/>
  </actuator>
  <sensor>
    <jointpos name="angle" joint="turn"/><jointvel name="rate" joint="turn"/>
    <jointpos name="bend_angle" joint="bend"/><accelerometer name="acc" site="tool"/>
  </sensor>
</mujoco>
"""
URDF = """<robot name="two">
  <link name="base"/>
  <link name="one"><inertial><origin xyz=".2 0 0"/><mass value="2"/>
    <inertia ixx=".02" iyy=".02" izz=".02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="two"><inertial><origin xyz=".1 0 0"/><mass value="1"/>
    <inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://two/two.stl"/></geometry></visual></link>
  <joint name="a" type="revolute"><parent link="base"/><child link="one"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="20" velocity="2"/></joint>
  <joint name="b" type="revolute"><parent link="one"/><child link="two"/><origin xyz=".4 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="10" velocity="2"/></joint>
</robot>
"""
MAPPING = b"""format = "loose-mapping/1"
model = "model.xml"
[sources.log]
file = "log.csv"
[sources.log.time]
column = "t"
unit = "s"
[columns]
"sensor.angle" = { source = "log", channel = "angle", unit = "rad" }
"sensor.rate" = { source = "log", channel = "rate", unit = "rad/s" }
[[runs]]
file = "run-01.parquet"
pose = { turn = 0.1, bend = 0.2 }
excited = ["turn"]
"""
PLACES = (b"model.xml", b"run.csv", b"run.parquet")


@functools.cache
def arm_text() -> bytes:
    """The arm of six joints that comes with the package."""
    return DESK_ARM.read_bytes()


def tetrahedron() -> bytes:
    """A mesh, as a binary STL file."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float) * 0.1
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    data = bytes(80) + struct.pack("<I", 4)
    for face in faces:
        data += struct.pack("<12fH", 0, 0, 0, *corners[list(face)].ravel(), 0)
    return data


@functools.cache
def recording() -> dict[str, bytes]:
    """Files of a recording of two runs, one as CSV and one as Parquet."""
    import pyarrow
    import pyarrow.parquet

    time = np.arange(40) / 100
    names = ["time", "ctrl.m1", "sensor.angle", "sensor.acc.x", "sensor.acc.y", "sensor.acc.z"]
    table = np.column_stack([time, *(np.cos((k + 1) * time) for k in range(5))])
    text = ",".join(names) + "\n" + "".join(",".join(map(repr, r)) + "\n" for r in table.tolist())
    stored = io.BytesIO()
    columns = {name: table[:, k] for k, name in enumerate(names)}
    pyarrow.parquet.write_table(pyarrow.table(columns), stored, write_page_checksum=True)
    described = {
        "format": "loose-recording/1",
        "model": "model.xml",
        "runs": [
            {"file": "run.csv", "excited": ["turn"], "pose": {"turn": 0.1, "bend": -0.2}},
            {"file": "run.parquet", "condition": "healthy"},
        ],
    }
    return {
        "recording.json": json.dumps(described, indent=1).encode(),
        "model.xml": MODEL.encode(),
        "run.csv": text.encode(),
        "run.parquet": stored.getvalue(),
    }


@functools.cache
def gap_result() -> bytes:
    """Result of a comparison."""
    from loose_env.gap import EffectLocation, Gap, GapResult, NamedEffect, RankedHypothesis

    effect = NamedEffect(
        kind="viscous_friction",
        where="bend",
        parameters={"damping": 3.0},
        interval_95={"damping": (2.9, 3.1)},
        units={"damping": "N·m·s/rad"},
        ambiguous_with=(EffectLocation(kind="sensor_gain", where="angle"),),
    )
    result = GapResult(
        verdict="named",
        gap=Gap(before=3.0, after=1.0, by_channel={"angle": (3.0, 1.0)}),
        effects=(effect,),
        ranking=(RankedHypothesis(kind="viscous_friction", where="bend", held_out=1.0, bic=-9.0),),
        settings={"tolerance": 0.03},
    )
    return result.to_json().encode()


@functools.cache
def _planned() -> Any:
    """A plan for the small arm."""
    from loose_env.instrument import NextSettings
    from loose_env.instrument import plan as planned

    with tempfile.TemporaryDirectory() as place, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = Path(place) / "arm.xml"
        model.write_text(MODEL)
        return planned(model, choice=NextSettings(poses=2, seconds=1.0, most_tool=2.0))


@functools.cache
def plan() -> bytes:
    """Content of a plan's file."""
    from loose_env.instrument import plan_json

    return json.dumps(plan_json(_planned(), ["run-01.csv"])).encode()


@functools.cache
def diagnosis_result() -> bytes:
    """Result of a diagnosis, with what it asks for next."""
    from loose_env.instrument import Diagnosis, Fault, RecordSeen, SlideDirection

    made = _planned()
    names = made.arm.hypotheses
    posterior = dict.fromkeys(names, 0.1 / (len(names) - 1)) | {"backlash@bend": 0.9}
    record = RecordSeen(
        file="run-01.csv",
        pose={"turn": 0.1, "bend": 0.2},
        excited=("turn",),
        condition="suspect",
        probabilities=posterior,
        direction_tool=(0.6, 0.0, 0.8),
        half_angle_deg=12.0,
    )
    result = Diagnosis(
        fault=Fault(kind="backlash", where="bend", gap_m=1e-4),
        probability=0.9,
        posterior=posterior,
        next=made.next,
        model="model.xml",
        warnings=("one record",),
        records=(record,),
        settings={"poses": 2, "seconds": 1.0, "healthy_prior": 0.5, "most_tool": 2.0},
        directions={"lower": SlideDirection(axis=(0.0, 1.0, 0.0), half_angle_deg=9.0)},
    )
    return result.to_json().encode()


@functools.cache
def shaken() -> dict[str, bytes]:
    """Files of a recording to diagnose: one short run, as CSV."""
    from dataclasses import replace

    from loose_env.recording import read_recording, write_recording
    from scripts.suites.trust.kills.commands import make_shaken_recording

    with tempfile.TemporaryDirectory() as place:
        make_shaken_recording(Path(place) / "long")
        whole = read_recording(Path(place) / "long")
        run, rows = whole.runs[0], slice(500, 1000)
        short = replace(
            run,
            name="run.csv",
            time=run.time[rows] - run.time[500],
            controls={name: v[rows] for name, v in run.controls.items()},
            sensors={name: v[rows] for name, v in run.sensors.items()},
        )
        write_recording(
            Path(place) / "short", model_xml=whole.model_path, runs=[short], file_format="csv"
        )
        return {p.name: p.read_bytes() for p in sorted(Path(place, "short").iterdir())}


LOG_COLUMNS = {
    "log.mcap": '"sensor.angle" = { topic = "/arm", channel = "q", unit = "rad" }',
    "log.csv": '"sensor.angle" = { channel = "q", unit = "rad" }',
    "log.uff": "\n".join(
        f'"sensor.acc.{axis}" = {{ channel = "1+{axis.upper()}" }}' for axis in "xyz"
    ),
}
"""What is imported of each kind of log."""


def log_mapping(name: str) -> bytes:
    """A mapping of one of the logs."""
    clock = 'time = { column = "t" }\n' if name == "log.csv" else ""
    text = f'format = "loose-mapping/1"\nmodel = "model.xml"\n[sources.s]\n{clock}[columns]\n'
    return f"{text}{LOG_COLUMNS[name]}\n[[runs]]\n".encode()


@functools.cache
def logs() -> dict[str, bytes]:
    """Files as loggers write them: MCAP, a table in text, a universal file."""
    import pyuff
    from mcap.writer import Writer

    time = np.arange(60) / 100
    angle = np.sin(3 * time)
    text = "t,q\n" + "".join(f"{t:.9g},{q:.9g}\n" for t, q in zip(time, angle, strict=True))
    packed = io.BytesIO()
    writer = Writer(packed)
    writer.start()
    schema = writer.register_schema("Arm", "jsonschema", b'{"type": "object"}')
    channel = writer.register_channel("/arm", "json", schema)
    for t, q in zip(time, angle, strict=True):
        ns = round(t * 1e9)
        message = json.dumps({"q": float(q)}).encode()
        writer.add_message(channel, log_time=ns, data=message, publish_time=ns)
    writer.finish()  # type: ignore[no-untyped-call]
    sets = [
        pyuff.prepare_58(
            id1="accelerometer", func_type=1, rsp_node=1, rsp_dir=k, ref_node=0, ref_dir=0,
            num_pts=len(time), abscissa_spacing=1, abscissa_spec_data_type=17,
            ordinate_spec_data_type=12, ordinate_axis_units_lab="m/s^2",
            orddenom_spec_data_type=0, z_axis_spec_data_type=0, data=angle * k, x=time,
        )
        for k in (1, 2, 3)
    ]  # fmt: skip
    with tempfile.TemporaryDirectory() as place, warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # it leaves its files open
        path = Path(place) / "log.uff"
        pyuff.UFF(str(path)).write_sets(sets, mode="add")
        universal = path.read_bytes()
    return {"log.mcap": packed.getvalue(), "log.csv": text.encode(), "log.uff": universal}


@functools.cache
def rows() -> dict[str, bytes]:
    """Rows of a comparison as JSON and as Parquet."""
    from loose_env.evaluation import write_rows

    row: dict[str, Any] = {"agent": "a", "seed": 1, "episode": 0, "reward": 0.5, "success": True}
    with tempfile.TemporaryDirectory() as place:
        for form in ("json", "parquet"):
            write_rows(place, "rows", [row, row | {"episode": 1}], {"env": "e"}, form=form)
        return {p.name: p.read_bytes() for p in Path(place).iterdir()}
