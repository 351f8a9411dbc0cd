"""What cannot be used is refused in one line that names the file and the place; no traceback."""

from __future__ import annotations

import json
import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from loose_env.cli.main import main
from loose_env.errors import LooseEnvError
from loose_env.importing import ImportSettings, import_recording
from loose_env.importing.sources import open_log
from tests.importing import arm_log
from tests.importing.sample_files import (
    IMU,
    JOINT_STATE,
    imu,
    joint_states,
    write_csv,
    write_robot,
    write_ros2,
)

Mapped = Callable[..., Path]

ONE = '[sources.s]\n{source}\n[columns]\n"sensor.{column}" = {{ {channel} }}\n[[runs]]\n{run}\n'
TIME = np.arange(50) / 100
CLOCK = 'time = { column = "t" }'
ELBOW = 'topic = "/joint_states", channel = "position[elbow]"'


def one(channel: str, *, source: str = "", column: str = "elbow_angle", run: str = "") -> str:
    return ONE.format(source=source, column=column, channel=channel, run=run)


def log_of(home: Path, name: str = "log.csv", *columns: np.ndarray) -> Path:
    names = ["t", "q", "w"][: 2 + len(columns)]
    return write_csv(home / name, np.stack([TIME, TIME, *columns], 1), names)


def refused(home: Path, files: Path | list[Path], mapped: Path) -> str:
    """The message, after making sure that it is one line and nothing was written."""
    before = sorted(home.iterdir())
    with pytest.raises(LooseEnvError) as error:
        import_recording([files] if isinstance(files, Path) else files, mapped, home / "out")
    assert sorted(home.iterdir()) == before
    assert "\n" not in str(error.value)
    return str(error.value)


# ------------------------------------------------------------------------- mappings


@pytest.mark.parametrize(
    ("channel", "words"),
    [
        ('topic = "/joint_state", channel = "position[elbow]"', "did you mean '/joint_states'"),
        ('channel = "position[elbow]"', "say which by topic"),
        ('topic = "/joint_states", channel = "positon[elbow]"', "did you mean 'position[elbow]'"),
        ('topic = "/joint_states", channel = "position[wrist]"', "there are 'position[elbow]'"),
        ('topic = "/joint_states", channel = "header"', "there is no channel 'header'"),
        (
            'topic = "/imu", channel = "linear_acceleration[0]"',
            "did you mean 'linear_acceleration.",
        ),
        (
            'topic = "/commands", channel = "data[lift]"',
            "there are 'layout.data_offset', 'data[0]', 'data[1]'",
        ),
        ('topic = "/imu", channel = "linear_acceleration.x", unit = "g"', "measures acceleration"),
    ],
)
def test_channels_that_are_not_there(home: Path, mapping: Mapped, channel: str, words: str) -> None:
    bag = write_robot(home / "robot.mcap", seconds=0.5)
    said = refused(home, bag, mapping(one(channel)))
    assert words in said
    assert "robot.mcap" in said or "map.toml" in said


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (one('channel = "q"', column="elbow_angel"), "did you mean 'sensor.elbow_angle'"),
        (one('channel = "q"', run='pose = { wrist = 1 }'), "no hinge or slide"),
        (one('channel = "q"', run='pose = { elbow = "3 kg" }'), "pose"),
        (one('channel = "q"', run='file = "../../run"'), "leaves the folder"),
        (one('channel = "q"', run="start = 1.7e9"), "start"),
        (one('channel = "q"', run="start = 0.3\nstop = 0.1"), "start is not before stop"),
        (one('channel = "q"', run="start = 0.1\nstop = 7"), "not within what all its channels"),
        (one('channel = "q"', run="rate_hz = 100"), "rate_hz"),
        (one('channel = "q"', run='condition = "sound"'), "is none of 'suspect' or 'healthy'"),
        (one('channel = "q", sign = 2'), "sign: 2 is none of 1 or -1"),
        (one('channel = "q", topic = "/a"'), "has no topics"),
        (one('channel = "w"'), "there is no column 'w'"),
        (one('channel = "q", sources = "x"'), "did you mean 'source'"),
        (one('channel = "q"', source='time = { column = "t", unit = "g" }'), "no unit of time"),
        (one('channel = "q"').partition("[[runs]]")[0], "'runs' is missing"),
        ("[[runs]]\n", "'sources' is missing"),
        ("[sources", "not TOML"),
        (f"a = {'[' * 100000}", "nested too deeply"),
    ],
)  # fmt: skip
def test_mappings_that_make_no_sense(home: Path, mapping: Mapped, text: str, words: str) -> None:
    if "time =" not in text and "[sources.s]\n" in text:
        text = text.replace("[sources.s]\n", f"[sources.s]\n{CLOCK}\n")
    said = refused(home, log_of(home), mapping(text))
    assert words in said
    assert "map.toml" in said or "log.csv" in said or "run " in said


def test_only_files_of_the_command_line_are_read(home: Path, mapping: Mapped) -> None:
    log, secret = log_of(home), log_of(home, "secret.csv")
    inner = home / "maps"
    inner.mkdir()
    for model in ("../other.xml", "../arm.xml"):
        text = f'format = "loose-mapping/1"\nmodel = "{model}"\n'
        (inner / "map.toml").write_text(text + one('channel = "q"', source=CLOCK))
        if model == "../other.xml":
            assert "given by --model" in refused(home, log, inner / "map.toml")
    for own in (None, home / "arm.xml"):
        assert import_recording([log], inner / "map.toml", home / "out", model=own).runs
        shutil.rmtree(home / "out")
    named = (
        one('channel = "q"', source=f'{CLOCK}\nfile = "{secret}"')
        .replace("[columns]", "[sources.other]\n[columns]")
        .replace("{ channel", '{ source = "s", channel')
    )
    assert "not among those given ('log.csv')" in refused(home, log, mapping(named))
    run = one('channel = "q"', source=CLOCK, run=f'sources = {{ s = "{secret}" }}')
    assert "not among those given ('log.csv')" in refused(home, log, mapping(run))


def test_the_command_line_needs_a_mapping(
    home: Path, mapping: Mapped, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = str(write_robot(home / "robot.mcap", seconds=0.2))
    for words in ([], ["--out", "x"], ["--describe", "--out", "x"]):
        with pytest.raises(SystemExit) as ended:
            main(["import", bag, *words])
        assert ended.value.code == 2
    capsys.readouterr()
    told = ["--mapping", str(mapping(one('channel = "q"'))), "--out", str(home / "out")]
    for words, reason in (
        ([str(home / "none.mcap")], "there is no file"),
        ([bag, bag], "two sources are called"),
        ([f"s={bag}", f"more={bag}"], "uses no file 'more'"),
    ):
        assert main(["import", *words, *told]) == 1
        said = capsys.readouterr().err
        assert reason in said and said.count("\n") == 1


# ------------------------------------------------------------------------- tables


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (["t,q", "0,1", "1,two", "2,3"], "line 3, column 'q': 'two' is no number"),
        (["t,q", *(f"{i},1" for i in range(6)), "6,2,5"], "line 8: 3 cells, and 2 columns"),
        (["t,q", *(f"{i},1" for i in range(6)), "", "6"], "line 9: 1 cells, and 2 columns"),
        (["t,q", "0,1", "2,2", "1,3"], "line 4: time runs backwards"),
        (["t,q", "0,1", "1,2", "1,3"], "line 4: time stands still"),
        (["t,q", "0,1", ",2", "1,3"], "line 3, column 't': '' is no time"),
        (["t,q", "0,1", "1,inf", "2,3"], "line 3: the value is infinite"),
        (["t,q,q", "0,1,1"], "there is no column 'q'; there are 't', '#2', '#3'"),
        ([], "there is no table"),
        (["t,q", '0,"1', "1,2"], "a quote that is not closed"),
        (["t,q" + "x" * 2**20, "0,1"], "longer than"),
    ],
)
def test_tables_that_are_damaged(home: Path, mapping: Mapped, lines: list[str], words: str) -> None:
    (home / "log.csv").write_text("\n".join(lines))
    said = refused(home, home / "log.csv", mapping(one('channel = "q"', source=CLOCK)))
    assert words in said
    assert said.startswith("log.csv")


def test_a_column_that_misses_more_than_a_fifth(home: Path, mapping: Mapped) -> None:
    log = log_of(home, "log.csv", np.where((TIME > 0.1) & (TIME < 0.3), np.nan, 1))
    text = one('channel = "q"', source=CLOCK).replace(
        "[[runs]]", '"sensor.shoulder_rate" = { channel = "w" }\n[[runs]]'
    )
    said = refused(home, log, mapping(text))
    assert "'sensor.shoulder_rate', from log.csv: column 'w': 38% of 50 rows" in said
    assert "0.110 s after the start" in said


# ------------------------------------------------------------------------- clocks


def test_sources_that_never_meet(home: Path, mapping: Mapped) -> None:
    bag = write_robot(home / "robot.mcap", seconds=0.2)
    text = (
        f'[sources.robot]\n[sources.log]\n{CLOCK}\n[columns]\n"sensor.elbow_angle" = '
        f'{{ source = "log", channel = "q" }}\n"sensor.shoulder_angle" = '
        f'{{ source = "robot", {ELBOW} }}\n[[runs]]\n'
    )
    said = refused(home, [bag, log_of(home)], mapping(text))
    assert "no time in common" in said and "from_start" in said


def test_late_stamps_are_not_those_of_the_header(home: Path, mapping: Mapped) -> None:
    rows = joint_states(np.arange(50) / 100, late_ns=3_000_000_000)
    kind = {"/joint_states": ("sensor_msgs/msg/JointState", JOINT_STATE, rows)}
    bag = write_ros2(home / "robot.mcap", kind)
    (table,) = open_log(bag).first()
    late = table.columns["log_time"] - table.columns["header.stamp"]
    assert table.time == "header.stamp" and np.all(late == 3_000_000_000)
    for i, source in enumerate(('time = { column = "log_time" }', "")):
        found = import_recording([bag], mapping(one(ELBOW, source=source)), home / f"out{i}")
        assert found.runs[0].samples == 50


# ------------------------------------------------------------------------- MCAP


def chunk(size: int, kind: bytes, packed: bytes) -> bytes:
    """An MCAP file of one chunk, as a hostile hand writes it."""
    body = struct.pack("<QQQI", 0, 0, size, 0) + struct.pack("<I", len(kind)) + kind
    body += struct.pack("<Q", len(packed)) + packed
    return b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, len(body)) + body


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.bag", b"#ROSBAG V2.0", "no whole ROS bag"),
        ("a.pkl", b"\x80\x04", "can hold code"),
        ("a.xyz", b"hello", ".xyz is not read; read are .csv"),
        ("a.mcap", chunk(2**62, b"zstd", b"x"), "cut short or damaged"),
        ("a.mcap", chunk(100, b"zstd", zstandard.compress(bytes(2**24))),
         "cut short or damaged"),
        ("a.mcap", chunk(3, b"", b"abc"), "cut short or damaged"),
        ("a.mcap", chunk(9, b"", struct.pack("<BQ", 5, 2**60)), "cut short or damaged"),
        ("a.mcap", chunk(31, b"", struct.pack("<BQHIQQ", 5, 22, 7, 0, 0, 0)),
         "cut short or damaged"),
        ("a.mcap", b"\x89MCAP0\r\n" + struct.pack("<BQ", 9, 2**63), "cut short or damaged"),
        ("a.mcap", b"\x89MCAP0\r\n", "cut short"),
        ("a.uff", b"    -1\n    58\n", ".uff is not read; read are .csv"),
    ],
)  # fmt: skip
def test_files_that_are_something_else_or_of_a_hostile_hand(
    home: Path, mapping: Mapped, name: str, content: bytes, words: str
) -> None:
    (home / name).write_bytes(content)
    said = refused(home, home / name, mapping(one('topic = "/a", channel = "q"')))
    for each in words.split(".*"):
        assert each in said


def test_messages_whose_bytes_or_checksum_are_wrong(home: Path, mapping: Mapped) -> None:
    file = home / "a.mcap"
    mapped = mapping(one('topic = "/imu", channel = "linear_acceleration.x"'))
    topics = {"/imu": ("sensor_msgs/msg/Imu", IMU, imu(np.arange(20) / 100))}
    write_ros2(file, topics, compression=CompressionType.NONE, enable_crcs=False)
    # The length of the frame's name becomes four gigabytes.
    raw = file.read_bytes().replace(b"\x05\0\0\0base\0", b"\xff\xff\xff\xffbase\0")
    file.write_bytes(raw)
    assert "message 1: it is damaged" in refused(home, file, mapped)
    write_robot(file, seconds=0.5, compression=CompressionType.NONE)
    flipped = bytearray(file.read_bytes())
    flipped[len(flipped) // 3] ^= 1
    file.write_bytes(bytes(flipped))
    assert "checksum mismatch" in refused(home, file, mapped)


def test_messages_of_other_than_ros2_say_so(home: Path, mapping: Mapped) -> None:
    with (home / "a.mcap").open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        channel = writer.register_channel("/tool", "json", writer.register_schema("T", "", b""))
        writer.add_message(channel, log_time=0, data=b"{}", publish_time=0)
        writer.finish()
    said = refused(home, home / "a.mcap", mapping(one('topic = "/tool", channel = "q"')))
    assert "Profile is not ros2" in said


# ------------------------------------------------------------------------- datasets, bags, archives

SHORT = arm_log.moved(1.0)
COLUMN = {
    "lerobot": 'channel = "observation.state[elbow.pos]", unit = "deg"',
    "bag": ELBOW,
    "demos.hdf5": 'channel = "obs/robot0_joint_pos[2]"',
    "sensors.npz": 'channel = "q[2]"',
}
WRITERS: dict[str, Callable[[Path], object]] = {
    "lerobot": lambda path: arm_log.write_lerobot(path, SHORT),
    "bag": lambda path: arm_log.write_bag(path, SHORT),
    "demos.hdf5": lambda path: arm_log.write_robomimic(path, SHORT),
    "sensors.npz": lambda path: np.savez(path, time=SHORT.time, q=SHORT.position),
}
FRAMES = "data/chunk-000/file-000.parquet"
POSITIONS = "data/demo_0/obs/robot0_joint_pos"


def info(folder: Path, **changes: object) -> None:
    path = folder / "meta/info.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def drop(folder: Path, column: str) -> None:
    pq.write_table(pq.read_table(folder / FRAMES).drop_columns([column]), folder / FRAMES)


def cut(path: Path, share: float = 0.5) -> None:
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * share)])


def database(folder: Path) -> Path:
    return next(folder.glob("*.db3"))


def positions(path: Path, *, value: Any, at: str = POSITIONS) -> None:
    with h5py.File(path, "r+") as file:
        del file[at]
        if value is not None:
            file[at] = value


SPOILT: list[tuple[str, Callable[[Path], object], str]] = [
    ("lerobot", lambda f: (f / "meta/info.json").unlink(), "meta/info.json"),
    ("lerobot", lambda f: cut(f / "meta/info.json"), "not JSON"),
    ("lerobot", lambda f: info(f, codebase_version="v9.0"), "'v9.0' is none of 'v2.0', 'v2.1'"),
    ("lerobot", lambda f: shutil.rmtree(f / "data"), "no Parquet files"),
    ("lerobot", lambda f: cut(f / FRAMES), "cut short or damaged"),
    ("lerobot", lambda f: drop(f, "observation.state"), "no column 'observation.state[elbow.pos]'"),
    ("bag", lambda f: cut(database(f)), "no whole ROS bag, cut short or damaged"),
    ("bag", lambda f: database(f).unlink(), "a folder without logs"),
    ("demos.hdf5", cut, "cut short or damaged"),
    ("demos.hdf5", lambda f: positions(f, value=None, at="data"), "it holds no arrays of numbers"),
    ("demos.hdf5", lambda f: positions(f, value=h5py.ExternalLink("other.hdf5", "/x")),
     "there is no column 'obs/robot0_joint_pos[2]'"),
    ("demos.hdf5", lambda f: positions(f, value=np.zeros((0, 3))),
     "there is no column 'obs/robot0_joint_pos[2]'"),
    ("demos.hdf5", lambda f: arm_log.write_robomimic(f, SHORT, rate=None),
     "no rate is assumed"),
    ("sensors.npz", lambda f: cut(f, 0.1), "cut short or damaged"),
    ("sensors.npz", lambda f: np.savez(f, a=np.zeros(3)), "is it a log?"),
    ("sensors.npz", lambda f: np.savez(f, times=np.arange(3.0), data=np.array([{}] * 3)),
     "Object arrays cannot be loaded"),
    ("sensors.npz", lambda f: np.savez(f, time=np.arange(20.0), q=np.zeros((19, 3))),
     "there is no column 'q[2]'"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "spoil", "words"), SPOILT)
def test_datasets_that_are_incomplete_damaged_or_unknown(
    home: Path, mapping: Mapped, name: str, spoil: Callable[[Path], object], words: str
) -> None:
    WRITERS[name](home / name)
    spoil(home / name)
    source = "time = { rate_hz = 125 }" if "demos" in name and "rate" not in words else ""
    source = 'time = { column = "time" }' if "npz" in name else source
    assert words in refused(home, home / name, mapping(one(COLUMN[name], source=source)))


@pytest.mark.parametrize(
    ("column", "run", "words"),
    [
        ('channel = "observation.state[elbow.pos]"', "", "unit = 'deg', unit = 'rad', or"),
        ('channel = "observation.state[elbow.pos]", unit = "V"', "", "measures voltage"),
        ('channel = "observation.state[elbo.pos]", unit = "deg"', "", "did you mean"),
        (
            'channel = "observation.state[7]", unit = "deg"',
            "",
            "there is no column 'observation.state[7]'",
        ),
        ('topic = "t", channel = "action[0]", unit = "deg"', "", "has no topics"),
        (COLUMN["lerobot"], "episodes = [0, 7]", "there is no episode 7; there are 2, from 0 to 1"),
        (COLUMN["lerobot"], 'episodes = "first"', "episodes"),
    ],
)
def test_columns_and_episodes_that_a_dataset_lacks(
    home: Path, mapping: Mapped, column: str, run: str, words: str
) -> None:
    WRITERS["lerobot"](home / "lerobot")
    assert words in refused(home, home / "lerobot", mapping(one(column, run=run)))


# ------------------------------------------------------------------------- anything at all

FREELY = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
COLUMNS = {
    "robot.mcap": f'"sensor.elbow_angle" = {{ {ELBOW} }}',
    "plain.mcap": f'"sensor.elbow_angle" = {{ {ELBOW} }}',
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The bytes of a sound file of each kind."""
    place = tmp_path_factory.mktemp("whole")
    bare = {"compression": CompressionType.NONE, "enable_crcs": False}
    write_robot(place / "robot.mcap", seconds=0.3)
    write_robot(place / "plain.mcap", seconds=0.3, **bare)
    return {path.name: path.read_bytes() for path in sorted(place.iterdir())}


@pytest.mark.slow
@pytest.mark.parametrize("name", list(COLUMNS))
@FREELY
@given(data=st.data())
def test_files_that_were_cut_or_whose_bytes_were_flipped(
    home: Path, mapping: Mapped, whole: dict[str, bytes], name: str, data: st.DataObject
) -> None:
    content, file = bytearray(whole[name]), home / name
    shortened = data.draw(st.booleans())
    if shortened:
        content = content[: data.draw(st.integers(0, len(content) - 12))]
    else:
        for _ in range(data.draw(st.integers(1, 8))):
            content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    file.write_bytes(bytes(content))
    mapped = mapping(f"[sources.s]\n[columns]\n{COLUMNS[name]}\n[[runs]]\n")
    try:
        open_log(file).first()
    except LooseEnvError as error:
        assert name in str(error)
    try:
        found = import_recording([file], mapped, home / "out", ImportSettings(overwrite=True))
    except LooseEnvError as error:
        assert name in str(error) or "map.toml" in str(error)
        assert not list(home.glob(".*.part"))
    else:
        assert not shortened
        assert all(np.isfinite(run.time).all() for run in found.runs)
