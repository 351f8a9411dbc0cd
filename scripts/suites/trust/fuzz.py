"""Read damaged and hostile files: each is refused by name in one line, or read.

    python -m scripts.suites.trust.fuzz --files 10000

Nothing outside the folder of a file may be opened, nothing written, nothing run; Python's audit
hooks watch. The same seed, kind and number always give the same file. Exit code 1 where an outcome
is neither "refused" nor "read". What ends its process shows by where the run stopped.
"""

from __future__ import annotations

import functools
import json
import os
import pickle
import re
import resource
import shutil
import struct
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.arms import DESK_ARM, describe_file, vera
from loose_env.cli.command import command
from loose_env.cli.main import main
from loose_env.diagnosis import AmortisedPosterior
from loose_env.envs import DiagnosisSettings, difficulty_named
from loose_env.errors import LooseEnvError
from loose_env.evaluation import read_rows, write_rows
from loose_env.gap import Gap, GapResult, NamedEffect, read_result
from loose_env.importing import import_recording
from loose_env.instrument import diagnose, read_diagnosis, read_plan
from loose_env.recording import Run, read_recording, write_recording
from scripts.example_recording import loose_arm

Rng = np.random.Generator
Files = dict[str, bytes]
WEIGHTS = Path(__file__).resolve().parents[3] / "agents" / "loose_agents" / "weights"
SECRET = "SECRET"
"""Name that only the files outside the folder carry: to see it is to have read one."""
FINE = ("refused", "read")
"""The outcomes that may occur; else crash, unclear, wrote, ran, leaked or slow."""
SLOW = 20.0
"""Longest that a file may take [s of processor time]."""
MEMORY = 8 * 2**30
"""Address space of the command's process [bytes]: who asks for more is refused it."""

# ------------------------------------------------------------------------- whole documents

MODEL = """<mujoco model="small">
  <compiler angle="radian"/>
  <option timestep="0.002"/>
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
time = { column = "t", unit = "s" }
[columns]
"sensor.angle" = { source = "log", channel = "angle", unit = "rad" }
[[runs]]
file = "run-01.parquet"
pose = { turn = 0.1, bend = 0.2 }
excited = ["turn"]
"""


def tetrahedron() -> bytes:
    """A mesh, as a binary STL file."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float) * 0.1
    data = bytes(80) + struct.pack("<I", 4)
    for face in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)):
        data += struct.pack("<12fH", 0, 0, 0, *corners[list(face)].ravel(), 0)
    return data


def _written(write: Callable[[Path], object], below: str = ".") -> Files:
    """Files that a function writes into a folder."""
    with tempfile.TemporaryDirectory() as place, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write(Path(place))
        home = Path(place) / below
        return {str(p.relative_to(home)): p.read_bytes() for p in home.rglob("*") if p.is_file()}


@functools.cache
def recording() -> Files:
    """A recording of two runs, one as CSV and one as Parquet."""
    time = np.arange(40) / 100
    waves = np.cos(np.outer(time, range(1, 6)))
    runs = [
        Run(name=name, time=time, controls={"m1": waves[:, 0]}, pose={"turn": 0.1},
            sensors={"angle": waves[:, 1], "acc": waves[:, 2:]}, excited=("turn",))
        for name in ("run.csv", "run.parquet")
    ]  # fmt: skip
    return _written(
        lambda place: write_recording(place, model_xml=MODEL, runs=runs, file_format=None)
    )


@functools.cache
def shaken() -> Files:
    """A recording to diagnose."""
    return _written(lambda place: loose_arm(place / "recording"), "recording")


@functools.cache
def results() -> Files:
    """Results of the two tools, a plan, and rows of a comparison."""
    effect = NamedEffect(
        kind="link_mass", where="upper", parameters={"mass": 0.1}, interval_95={"mass": (0.0, 0.2)}
    )
    gap = GapResult(verdict="named", gap=Gap(before=3.0, after=1.0), effects=(effect,))
    row: dict[str, Any] = {"agent": "a", "seed": 1, "episode": 0, "reward": 0.5, "success": True}

    def write(place: Path) -> None:
        for name, data in shaken().items():
            (place / "r").mkdir(exist_ok=True)
            (place / "r" / name).write_bytes(data)
        main(["diagnose", str(place / "r"), "--out", str(place / "d"), "--quiet"])
        main(["plan", str(place / "r" / "model.xml"), "--out", str(place / "p"), "--quiet"])
        write_rows(place, "rows", [row, row | {"episode": 1}], {"env": "e"}, form="json")
        (place / "gap.json").write_text(gap.to_json())

    found = _written(write)
    return {
        "gap.json": found["gap.json"],
        "diagnosis.json": found["d/result.json"],
        "plan.json": found["p/plan.json"],
        "rows.json": found["rows.json"],
    }


# -------------------------------------------------------------------------------- damage

_NUMBERS = ("1e999", "-1e308", "9" * 400, "9" * 5000, "1e-400", "NaN", "Infinity", "0x7fffffff")
"""Numbers that are none, or more than fits."""
_PATHS = (
    *("../secret/secret.csv", "/etc/passwd", "..\\secret\\secret.csv", "C:\\secret.csv"),
    *("\\\\server\\share\\a.csv", "a\x00b.csv", "link.csv", "sub/../../x", "file:///etc/passwd"),
    *("http://127.0.0.1:9/a.csv", "a" * 5000, "~/x.csv", "$(touch x)", ".", "pipe.csv", "", " "),
)
"""Paths that lead elsewhere, or nowhere."""
_VALUES: tuple[Any, ...] = (
    *(None, True, [], {}, "", 0, -1, 1e308, 2**70, 10**400, [[]], {"a": {}}, "x" * 5000, "\x00"),
    *([1, "a", None], {"file": "../x"}, -0.0, "nan", "1e5", [[[[[[1]]]]]], *_PATHS),
)
_PLACES = (
    *("../secret/secret.xml", "..\\secret\\secret.xml", "sub/../../secret/secret.xml", "link.xml"),
    *("{secret}/secret.xml", "file:///etc/passwd", "http://127.0.0.1:9/a.xml", "pipe.xml"),
    *("/dev/zero", "package://../secret/secret.xml", "\\\\server\\share\\a.xml"),
)
ELEMENTS: tuple[str, ...] = (
    *(f'<include file="{place}"/>' for place in _PLACES),
    *(f'<asset><mesh name="m" file="{p.replace("xml", "stl")}"/></asset>' for p in _PLACES),
    *(f'<asset><model name="m" file="{place}"/></asset>' for place in _PLACES[:6]),
    *(f'<asset><hfield name="h" size="1 1 1 1" file="{p}"/></asset>' for p in _PLACES[:4]),
    *(f'<asset><texture name="t" type="2d" file="{p}"/></asset>' for p in _PLACES[:4]),
    *(f'<deformable><skin name="s" file="{p}"/></deformable>' for p in _PLACES[:3]),
    '<compiler meshdir="../secret"/><asset><mesh name="m" file="secret.stl"/></asset>',
    '<compiler assetdir="{secret}"/><asset><mesh name="m" file="secret.stl"/></asset>',
    '<compiler meshdir="sub"/><include file="part.xml"/>',
    '<asset xmlns="x"><include file="inner.xml"/></asset>',
    '<extension><plugin plugin="../evil.so"/></extension>',
    '<extension><plugin plugin="mujoco.sdf.torus"><instance name="a"/></plugin></extension>',
    '<worldbody><replicate count="100000000"><site/></replicate></worldbody>',
    '<worldbody><flexcomp name="f" type="grid" count="999 999 999" spacing=".1 .1 .1"/>'
    "</worldbody>",
    "<worldbody>" + "<body>" * 600 + "</body>" * 600 + "</worldbody>",
    '<asset><texture type="2d" name="t" builtin="flat" width="99999" height="99999"/></asset>',
    '<asset><hfield name="h" nrow="99999" ncol="99999" size="1 1 1 1"/></asset>',
    '<asset><mesh name="m" builtin="sphere" params="1000000"/></asset>',
    '<size memory="99999G"/>',
    '<size nuserdata="2000000000"/>',
    '<custom><numeric name="n" size="2000000000"/></custom>',
    '<option timestep="0"/>',
    '<option timestep="-1" gravity="nan nan nan"/>',
    '<keyframe><key qpos="' + "1 " * 5000 + '"/></keyframe>',
    '<compiler eulerseq="xxx"/>',
    '<default class="a"><default class="a"/></default>',
)
"""Put in before the end of a model; ``{secret}`` becomes the full path of a folder outside."""
WHOLE: tuple[str, ...] = (
    '<!DOCTYPE m [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">'
    + "".join(f'<!ENTITY c{k} "{"&b;" * 10}">' for k in range(9))
    + "]><mujoco model='&c8;'/>",
    '<!DOCTYPE m [<!ENTITY a SYSTEM "file:///etc/passwd">]><mujoco model="&a;"/>',
    '<mujoco xmlns:xi="http://www.w3.org/2001/XInclude"><xi:include href="/etc/passwd"/></mujoco>',
    "<mujoco>" * 100_000,
    "<robot name='r'><link name='a'/><joint name='j' type='revolute'><parent link='a'/>"
    "<child link='a'/></joint></robot>",
)
YAML: tuple[str, ...] = (
    "default: !!python/object/apply:os.system ['touch EXECUTED']",
    "default: {policy_kwargs: \"__import__('os').system('touch EXECUTED')\"}",
    "default: {learning_rate: \"lin___import__('os')\"}",
    "a: &b0 [x,x,x,x,x,x,x,x,x]\n"
    + "".join(f"b{k + 1}: &b{k + 1} [{','.join([f'*b{k}'] * 9)}]\n" for k in range(12))
    + "default: *b12",
    "default: &d {n_envs: *d}",
    "default: {n_envs: " + "9" * 5000 + "}",
    "default: " + "[" * 5000,
)
"""Files of hyperparameters that ask for code, or for all memory."""


class Trap:
    """Unpickling it makes a file: the proof that something ran."""

    def __init__(self, place: Path) -> None:
        self.place = place

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.place,)


def damaged(name: str, data: bytes, rng: Rng, home: Path) -> bytes:
    """Damage a file by its kind: a value, an element, a word, or its bytes."""
    kind, chance = name.rpartition(".")[2], rng.random()
    if chance < 0.03:
        return pickle.dumps(Trap(home.parent / "cwd" / "EXECUTED"))
    if kind == "json" and chance < 0.75:
        return _damaged_tree(data, rng)
    if kind in ("xml", "urdf") and chance < 0.6:
        if chance < 0.1:
            return str(rng.choice(WHOLE)).encode()
        word = str(rng.choice(ELEMENTS)).replace("{secret}", str(home.parent / "secret"))
        end = b"</robot>" if kind == "urdf" else b"</mujoco>"
        return data.replace(end, word.encode() + end)
    if kind == "yml" and chance < 0.4:
        return str(rng.choice(YAML)).encode()
    if kind in ("json", "xml", "urdf", "csv", "toml", "yml") and rng.random() < 0.6:
        return _damaged_text(data.decode(), rng)
    return _damaged_bytes(data, rng)


def _damaged_bytes(data: bytes, rng: Rng) -> bytes:
    a = int(rng.integers(max(len(data), 1)))
    b = min(len(data), a + int(rng.integers(1, max(len(data) // 3, 2))))
    flipped = bytearray(data)
    for _ in range(8 if data else 0):
        flipped[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    ways = (data[:a], data[:a] + data[b:], data[:b] + data[a:], bytes(flipped),
            data[:a] + rng.bytes(20) + data[a:], data[:a] + bytes(b - a) + data[b:])  # fmt: skip
    return ways[int(rng.integers(len(ways)))]


def _damaged_text(text: str, rng: Rng) -> bytes:
    way, at = int(rng.integers(7)), int(rng.integers(len(text) + 1))
    found = list(re.finditer(r"-?\d+(\.\d+)?", text))
    if way < 3 and found:
        one = found[int(rng.integers(len(found)))]
        text = text[: one.start()] + str(rng.choice(_NUMBERS)) + text[one.end() :]
    elif way == 3:
        text = text[:at] + str(rng.choice(["\x00", "null", "'; import os", "１", '"'])) + text[at:]
    elif way == 4:
        text = "".join(rng.permutation(text.splitlines(keepends=True)))
    elif way == 5:
        return b"[" * 100_000 + text.encode() + b"]" * 100_000
    else:
        return text.encode("utf-16")
    return text.encode("utf-8", "surrogatepass")


def _damaged_tree(data: bytes, rng: Rng) -> bytes:
    tree = json.loads(data)
    nodes, waiting = [], [tree]
    while waiting:
        node = waiting.pop()
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        nodes += [(node, key) for key in keys]
        waiting += [node[key] for key in keys if isinstance(node[key], (dict, list))]
    node, key = nodes[int(rng.integers(len(nodes)))]
    way = rng.random()
    if way < 0.6:
        node[key] = _VALUES[int(rng.integers(len(_VALUES)))]
    elif way < 0.8 or isinstance(node, list):
        del node[key]
    elif way < 0.9:
        node[str(key) + "s"] = node.pop(key)
    else:
        node["__class__"] = {"py/object": "os.system", "args": ["touch executed"]}
    return json.dumps(tree).encode("utf-8", "surrogatepass")


# ------------------------------------------------------------------------------- readers


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of file: whole ones, which of them is damaged, and what reads them."""

    files: Callable[[], Files]
    damaged: tuple[str, ...]
    read: Callable[[Path], Any]
    """Given the folder of the files."""
    names: tuple[str, ...] = ()
    """What a refusal may name in place of one of the files."""


def _read_recording(home: Path) -> Any:
    found = read_recording(home)
    for run in found.runs:
        assert np.isfinite(run.time).all() and (np.diff(run.time) > 0).all()
        assert not any(np.isinf(v).any() for v in (*run.sensors.values(), *run.controls.values()))
    model = found.model()
    return [run.name for run in found.runs], [model.body(k).name for k in range(model.nbody)]


def _diagnosed(home: Path) -> Any:
    found = diagnose(read_recording(home))
    shown = [place.probability for place in found.places]
    assert np.isfinite(shown).all() and sum(shown) < 1 + 1e-6
    return found.to_json()


def _imported(home: Path) -> Any:
    found = import_recording([home / "log.csv"], home / "map.toml", home.parent / "work" / "made")
    return [(run.name, run.samples) for run in found.runs]


def _hyperparameters(home: Path) -> Any:
    from loose_agents.rl.hyperparameters import model_arguments, read_hyperparameters

    found = read_hyperparameters(home / "conf.yml", "loose_env/Vera-v0")
    return sorted(model_arguments(found, "ppo"))


@functools.cache
def _problem() -> Any:
    from loose_agents.base import Problem

    return Problem.of(vera(), DiagnosisSettings())


def _policy(home: Path) -> Any:
    from loose_agents.rl.agents import LearnedAgent

    return LearnedAgent.load(_problem(), home).form.observation_space.shape


def _posterior(home: Path) -> Any:
    problem = _problem()
    mismatch = difficulty_named(problem.settings.difficulty).mismatch
    found = AmortisedPosterior.load(home, problem.linear, problem.settings.sensors, mismatch)
    return found.features.locations


def _weights(folder: str) -> Callable[[], Files]:
    return lambda: {p.name: p.read_bytes() for p in (WEIGHTS / folder).iterdir() if p.is_file()}


def _result(name: str, read: Callable[[Path], Any]) -> Kind:
    return Kind(
        files=lambda: {name: results()[name]}, damaged=(name,), read=lambda home: read(home / name)
    )


def _arm(name: str, text: bytes) -> Kind:
    return Kind(
        files=lambda: {name: text, "two.stl": tetrahedron()}, damaged=(name,),
        read=lambda home: str(describe_file(home / name)), names=("arm 'arm'", *_INNER),
    )  # fmt: skip


def _log() -> Files:
    moment = np.arange(60) / 100
    text = "t,angle\n" + "".join(f"{t:.9g},{np.sin(3 * t):.9g}\n" for t in moment)
    return {"log.csv": text.encode(), "map.toml": MAPPING, "model.xml": MODEL.encode()}


_HYPER = WEIGHTS.parent / "hyperparams" / "ppo.yml"
_INNER = ("part.xml", "inner.xml")
KINDS: dict[str, Kind] = {
    "recording": Kind(
        files=recording, damaged=tuple(recording()), read=_read_recording, names=(*_INNER, "case")
    ),
    "recording to diagnose": Kind(
        files=shaken, damaged=("recording.json", "model.xml", "plan.json"), read=_diagnosed,
        names=(*_INNER, "case", "arm 'model'", "model and runs", "all runs", "run-"),
    ),
    "MJCF": _arm("arm.xml", MODEL.encode()),
    "MJCF, six joints": _arm("arm.xml", DESK_ARM.read_bytes()),
    "URDF": _arm("arm.urdf", URDF.encode()),
    "gap result": _result("gap.json", read_result),
    "diagnosis result": _result("diagnosis.json", read_diagnosis),
    "plan": _result("plan.json", read_plan),
    "rows": _result("rows.json", read_rows),
    "log and mapping": Kind(files=_log, damaged=("log.csv", "map.toml"), read=_imported),
    "hyperparameters": Kind(
        files=lambda: {"conf.yml": _HYPER.read_bytes()}, damaged=("conf.yml",),
        read=_hyperparameters,
        names=("hyperparameter", "policy", "normalize", "is a number", "known are"),
    ),
    "policy": Kind(files=_weights("ppo-vera-default"), read=_policy, names=("case",),
                   damaged=("policy.safetensors", "configuration.json")),
    "posterior": Kind(files=_weights("posterior-vera-default"), read=_posterior, names=("case",),
                      damaged=("posterior.safetensors", "configuration.json")),
}  # fmt: skip


# --------------------------------------------------------------------------------- watch

_RUNS = (
    *("os.system", "subprocess.Popen", "os.exec", "os.spawn", "os.posix_spawn", "os.fork"),
    *("socket.connect", "pty.spawn", "webbrowser.open"),
)


class Watch:
    """Folders of a file with what must not be touched, and audit hooks that note what is done."""

    def __init__(self, root: Path) -> None:
        self.root = root.resolve()
        self.home, self.secret, self.work, self.cwd = (
            self.root / name for name in ("case", "secret", "work", "cwd")
        )
        for folder in (self.secret, self.work, self.cwd):
            folder.mkdir(parents=True)
        include = f'<mujocoinclude><worldbody><body name="{SECRET}"/></worldbody></mujocoinclude>'
        (self.secret / "secret.xml").write_text(include)
        (self.secret / "secret.stl").write_bytes(tetrahedron())
        (self.secret / "secret.csv").write_text(f"time,{SECRET}\n0,1\n")
        self.noted: list[str] = []
        self.on = False
        sys.addaudithook(self._hear)  # it cannot be taken off again

    def fresh(self, files: Files) -> Path:
        """Empty the folder of the file, lay links and a pipe into it, and write files."""
        shutil.rmtree(self.home, ignore_errors=True)
        (self.home / "sub").mkdir(parents=True)
        for kind in ("xml", "stl", "csv"):
            (self.home / f"link.{kind}").symlink_to(self.secret / f"secret.{kind}")
            os.mkfifo(self.home / f"pipe.{kind}")
        for name, inside in (("part", '<asset><mesh name="m" file="link.stl"/></asset>'),
                             ("inner", '<include file="../secret/secret.xml"/>')):  # fmt: skip
            (self.home / f"{name}.xml").write_text(f"<mujocoinclude>{inside}</mujocoinclude>")
        for name, data in files.items():
            (self.home / name).write_bytes(data)
        return self.home

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.on:
            return
        if event in _RUNS:
            self.noted.append(f"ran: {event} {str(arguments)[:80]}")
        elif event == "ctypes.dlopen":
            if Path(os.path.realpath(str(arguments[0]))).is_relative_to(self.root):
                self.noted.append(f"ran: {arguments[0]}")
        elif event == "open" and isinstance(arguments[0], str):
            path, flags = Path(os.path.realpath(arguments[0])), arguments[2] or 0
            writes = bool(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
            if writes and not path.is_relative_to(self.work):
                self.noted.append(f"wrote: {path}")
            if path.is_relative_to(self.secret):
                self.noted.append(f"leaked: {path}")

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Note what is done, with temporary files in the folder that may be written to."""
        self.noted.clear()
        before, tempfile.tempdir = tempfile.tempdir, str(self.work)
        self.on = True
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                yield
        finally:
            self.on, tempfile.tempdir = False, before
            shutil.rmtree(self.work)
            self.work.mkdir()

    def judged(self, read: Callable[[], Any], names: tuple[str, ...] = ("",)) -> tuple[str, str]:
        """Let something be read; return the outcome and what was said."""
        outcome, said, start = "read", "", time.process_time()
        there = sorted(self.root.rglob("*"))
        with self.listening():
            try:
                shown = repr(read())
            except LooseEnvError as error:
                outcome, said = "refused", str(error)
            except BaseException as error:
                outcome, said = "crash", f"{type(error).__name__}: {str(error)[:300]}"
            else:
                if SECRET in shown:
                    self.noted.append("leaked: what was read holds what lies outside")
        spent = time.process_time() - start
        if sorted(self.root.rglob("*")) != there:
            return "wrote", "files lie there that did not before"
        if self.noted:
            outcome, _, said = self.noted[0].partition(": ")
        elif SECRET in said:
            outcome = "leaked"
        elif outcome == "refused" and (
            "\n" in said or len(said) > 2000 or not any(name in said for name in names)
        ):
            outcome = "unclear"
        if outcome in FINE and spent > SLOW:
            outcome, said = "slow", f"{spent:.0f} s {said[:100]}"
        return outcome, said[:400]


def tried(kind: str, number: int, watch: Watch, seed: int = 1) -> tuple[str, str]:
    """Make one damaged file and let it be read; the outcome and what was said."""
    sequence = np.random.SeedSequence(seed, spawn_key=(list(KINDS).index(kind), number))
    rng, own = np.random.default_rng(sequence), KINDS[kind]
    files = dict(own.files())
    name = str(rng.choice(own.damaged))
    files[name] = damaged(name, files[name], rng, watch.home)
    home = watch.fresh(files)
    return watch.judged(lambda: own.read(home), (*files, *own.names))


@dataclass(frozen=True, kw_only=True)
class FuzzSettings:
    """How many files."""

    files: int = 10_000
    """Files in all, of every kind the same number."""
    kinds: tuple[str, ...] = tuple(KINDS)
    """Kinds of files."""
    first: int = 0
    """Number of the first file of each kind."""
    seed: int = 1
    """Seed of the damage."""


def run(given: FuzzSettings) -> None:
    """Read the files and print a table of the outcomes."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    wrong = 0
    with tempfile.TemporaryDirectory(prefix="trust-") as place:
        watch = Watch(Path(place))
        os.chdir(watch.cwd)
        for kind in given.kinds:
            counts: Counter[str] = Counter()
            for number in range(given.first, given.first + given.files // len(given.kinds)):
                print(f"\r{kind} {number}", end="", file=sys.stderr, flush=True)
                outcome, said = tried(kind, number, watch, given.seed)
                counts[outcome] += 1
                if outcome not in FINE:
                    wrong += 1
                    print(f"\n{kind} {number}: {outcome}: {said}", flush=True)
            print(f"\r| {kind} | " + ", ".join(f"{n} {o}" for o, n in counts.items()) + " |")
        os.chdir("/")
    if wrong:
        sys.exit(1)


if __name__ == "__main__":
    command("fuzz", __doc__, FuzzSettings, run)
