"""Golden results of every part, computed anew and compared with the stored ones, or stored.

    python -m scripts.suites.golden                        # compute all parts and compare
    python -m scripts.suites.golden environments gap       # these parts alone
    python -m scripts.suites.golden thesis --page out/thesis/index.html
    python -m scripts.suites.golden gap --because "words of the line in CHANGELOG.md"

With --because the figures are written anew, where a change of them is meant. The words have to
stand in CHANGELOG.md under what is not released yet, and must not have served for an earlier
change: whoever gets other figures from the same seeds is told why.

Everything is computed through what users call: commands, `gymnasium.make`, `make_agent`.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import html
import io
import json
import os
import re
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

# The order in which threads of BLAS add up changes the last digits.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import gymnasium
import mujoco
import numpy as np
from loose_agents.base import Problem
from loose_agents.registry import make_agent
from tyro.conf import Positional

import loose_env  # noqa: F401  (registers the ids)
from loose_env.arms import DESK_ARM
from loose_env.cli.command import command, one_of
from loose_env.cli.main import main as loose
from loose_env.errors import InvalidSetting
from loose_env.io import plain, write_text
from loose_env.recording import Run, write_recording
from scripts.example_recording import loose_arm

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "tests" / "golden"
"""The kept figures, a file for each part."""
MEASURED = ROOT.parent / "shared" / "measured"
"""Recordings of real machines, where there are any; what needs them is skipped elsewhere."""
DIGITS = 6
"""Significant digits that are kept."""
_digits = functools.partial(plain, digits=DIGITS)
SEED = 20260101

# ------------------------------------------------------------------------- environments

_SHORT = {"durations": (0.1, 0.15)}
"""Loose stops that are struck carry on what a processor rounds another way: after half a second an
arm may be somewhere else."""
_REDUCED = {"engine": "reduced"}
ENVIRONMENTS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("loose_env/Vera-v0", _SHORT),
    ("loose_env/Vera-v0", _SHORT | _REDUCED | {"difficulty": "easy"}),
    ("loose_env/Planar-v0", _SHORT | {"n_links": 3, "hold": "servo"}),
    ("loose_env/Planar-v0", _SHORT | _REDUCED | {"n_links": 4, "max_excited": 2}),
    ("loose_env/SixAxis-v1", _SHORT | {"link_accelerometers": True}),
    ("loose_env/SixAxis-v1", _SHORT | _REDUCED | {"difficulty": "hard"}),
    ("loose_env/Scara-v1", _SHORT | {"difficulty": "easy"}),
    ("loose_env/Scara-v1", _SHORT | _REDUCED | {"hold": "compliant"}),
    ("loose_env/Arm-v1", _SHORT),
    ("loose_env/Arm-v1", _SHORT | _REDUCED),
    ("loose_env/ControlTier-v0", _SHORT),
    ("loose_env/ControlTier-v0", _SHORT | _REDUCED),
    ("loose_env/StoppingTier-v0", {}),
    ("loose_env/StoppingTier-v0", _REDUCED),
    ("loose_env/GravityTier-v1", {}),
    ("loose_env/GravityTier-v1", _REDUCED),
    ("loose_env/WeakDriveTier-v1", {}),
    ("loose_env/WeakDriveTier-v1", _REDUCED),
)
"""Environments whose episodes are kept, on both engines."""
WIDTH, RECORDS = 3, 2
ROUNDED = "loose_env/StoppingTier-v0"
"""Environment whose traces tell how a processor rounds."""


def environments(threads: int = 1) -> dict[str, Any]:
    """Episodes of every environment id, one arm alone and three side by side."""
    found = {}
    seeds = list(range(SEED, SEED + WIDTH))
    for env_id, arguments in ENVIRONMENTS:
        one: Any = gymnasium.make(env_id, disable_env_checker=True, **arguments)
        single, last = _played(one, SEED, 1)
        many: Any = gymnasium.make_vec(env_id, num_envs=WIDTH, threads=threads, **arguments)
        found[f"{env_id} {json.dumps(arguments)}"] = {
            "single": single | {"fault": last["fault"], "verdict": last["verdict"]},
            "vector": _played(many, seeds, WIDTH)[0],
        }
    return found


def _played(env: Any, seed: int | list[int], width: int) -> tuple[dict[str, Any], Any]:
    """Trace of an episode, and the last info."""
    rng = np.random.default_rng(SEED)
    observation, info = env.reset(seed=seed)
    seen, rewards, infos = [observation], [], [info]
    for actions in _actions(env.unwrapped, rng, width):
        observation, reward, _, _, info = env.step(actions if width > 1 else actions[0])
        seen.append(observation)
        rewards.append(reward)
        infos.append(info)
    env.close()
    return _trace(seen, rewards, infos), info


def _actions(env: Any, rng: np.random.Generator, width: int) -> Any:
    """Random records, the last action a verdict."""
    nvec = env.actions.nvec
    for step in range(RECORDS + 1):
        drawn = rng.integers(0, nvec, size=(width, len(nvec)))
        drawn[:, -1] = 1 if step == RECORDS else 0
        yield drawn


def _trace(seen: Sequence[Any], rewards: Sequence[Any], infos: Sequence[Any]) -> dict[str, Any]:
    whole = np.array(seen)
    return {
        "observations": _digits((whole.astype(float) ** 2).sum(axis=-1).tolist()),
        "rewards": _digits(np.array(rewards).tolist()),
        "info": sorted({str(key) for info in infos for key in info}),
        "bits": hashlib.sha256(whole.tobytes() + np.array(rewards).tobytes()).hexdigest()[:16],
    }


def gap_environment() -> dict[str, Any]:
    """Episodes of the environment that chooses motions, on a part of the catalogue."""
    kinds = ("viscous_friction", "coulomb_friction", "actuator_gain")
    with contextlib.redirect_stderr(io.StringIO()):
        env: Any = gymnasium.make(
            "loose_env/Gap-v0", disable_env_checker=True, library="battery", kinds=kinds
        )
    found: dict[str, Any] = {}
    for episode in range(3):
        observation, info = env.reset(seed=SEED + episode)
        seen, rewards, infos = [observation], [], [info]
        motions = np.flatnonzero(info["action_mask"])  # before the first, no verdict
        most_probable = len(motions)
        for action in (*motions[:: max(1, len(motions) // 3)][:3], most_probable):
            observation, reward, _, _, info = env.step(int(action))
            seen.append(observation)
            rewards.append(float(reward))
            infos.append(info)
        trace = _trace(seen, rewards, infos)
        found[str(episode)] = trace | {"truth": list(info["truth"])}
    env.close()
    return found


# ------------------------------------------------------------------------------- agents

EPISODES = 20
AGENTS = ("classical", "greedy", "ppo")


def agents() -> dict[str, Any]:
    """Twenty episodes of three agents on the same arms."""
    return {name: _episodes(name, "loose_env/Vera-v0", {}, range(EPISODES)) for name in AGENTS}


def posterior() -> dict[str, Any]:
    """Posterior of the environment after each of three records, under every hypothesis."""
    found = {}
    for env_id, arguments in (
        ("loose_env/Vera-v0", {}),
        ("loose_env/Planar-v0", {"n_links": 3}),
        ("loose_env/SixAxis-v1", _REDUCED),
    ):
        more: dict[str, Any] = {**arguments, **_SHORT, "max_records": 3}
        found[f"{env_id} {json.dumps(more)}"] = _episodes(
            "posterior/random", env_id, more, None, probabilities=True
        )
    return found


def _episodes(
    name: str,
    env_id: str,
    arguments: Mapping[str, Any],
    numbers: Sequence[int] | None,
    probabilities: bool = False,
) -> list[Any]:
    """Play episodes by number, or one of each hypothesis."""
    env: Any = gymnasium.make(env_id, disable_env_checker=True, **arguments)
    inner = env.unwrapped
    agent = make_agent(name, Problem.of(inner.arm, inner.settings), seed=0)
    hidden = [None] * len(numbers) if numbers is not None else list(inner.hypotheses)
    played = []
    for number, fault in enumerate(hidden):
        options = None if fault is None else {"fault": fault}
        observation, info = env.reset(seed=SEED + number, options=options)
        states, total, ended, steps, said = None, 0.0, False, [], []
        while not ended:
            begin = np.array([states is None])
            action, states = agent.predict(observation[None], states, begin, deterministic=True)
            p = None if states is None else getattr(states[0], "probabilities", None)
            if p is not None:
                said.append(_digits(np.asarray(p if probabilities else np.max(p)).tolist()))
            steps.append("".join(map(str, np.asarray(action[0]).tolist())))
            observation, reward, terminated, truncated, info = env.step(np.asarray(action[0]))
            total += float(reward)
            ended = terminated or truncated
        played.append(
            {
                "fault": info["fault"],
                "verdict": info["verdict"],
                "reward": _digits(total),
                "actions": steps,
                "probabilities": said,
            }
        )
    env.close()
    return played


# ------------------------------------------------------------------- recordings of loose gap

_STEP = 0.002
_GRAVITY = {"flat": "0 0 0", "upright": "0 0 -9.81"}


def _arm(joints: int, *, gravity: str = "flat", drive: str = "motor", step: float = _STEP) -> str:
    """Model of a planar arm of equal links, its joints about the y axis."""
    body, sensors, drives = "", "", ""
    for k in range(joints):
        body += (
            f'<body name="link{k + 1}" pos="{0.3 if k else 0} 0 0"><joint name="j{k + 1}" '
            f'axis="0 1 0" damping="{0.5 / (k + 1)}" armature="{0.05 / (k + 1)}"/>'
            f'<inertial pos=".15 0 0" mass="{2 / (k + 1)}" diaginertia=".002 .02 .02"/>'
        )
        sensors += f'<jointpos name="q{k + 1}" joint="j{k + 1}"/>'
        drives += (
            f'<motor name="m{k + 1}" joint="j{k + 1}"/>'
            if drive == "motor"
            else f'<position name="m{k + 1}" joint="j{k + 1}" kp="{120 / (k + 1)}" '
            f'kv="{6 / (k + 1)}"/>'
            if drive == "servo"
            else ""
        )
    body += '<site name="tool" pos=".3 0 0"/>' + "</body>" * joints
    return (
        f'<mujoco><option timestep="{step}" integrator="RK4" gravity="{_GRAVITY[gravity]}"/>'
        f"<worldbody>{body}</worldbody><actuator>{drives}</actuator>"
        f'<sensor>{sensors}<accelerometer name="acc" site="tool"/></sensor></mujoco>'
    )


def _changed(element: str, name: str, **values: Any) -> Callable[[Any], None]:
    """A change of an attribute of an element of a spec."""
    (each,) = values.items()
    return lambda spec: setattr(getattr(spec, element)(name), *each)


_DAMPED = _changed("joint", "j1", damping=np.array([1.4, 0, 0]))
_RUBBING = _changed("joint", "j1", frictionloss=0.6)
_HEAVY = _changed("body", "link2", mass=1.5)


def _weak(spec: Any) -> None:
    spec.actuator("m2").gainprm[0] *= 0.8
    spec.actuator("m2").biasprm[1] *= 0.8


def _playing(spec: Any) -> None:
    """Free travel between a joint's drive and its link: a second hinge between stops."""
    spec.body("link1").add_joint(
        name="play", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0], range=[-0.01, 0.01],
        limited=True, solref_limit=[0.004, 1], damping=np.array([0.01, 0, 0]),
    )  # fmt: skip


GAPS: dict[str, dict[str, Any]] = {
    "forward, damping": {"truth": _DAMPED},
    "forward, dry friction": {"truth": _RUBBING},
    "forward, healthy": {},
    "forward, play": {"truth": _playing},
    "forward, servos, heavy link": {
        "truth": _HEAVY, "joints": 2, "gravity": "upright", "drive": "servo",
    },
    "forward, servos, late": {"drive": "servo", "late": 0.012},
    "inverse, dry friction": {"truth": _RUBBING, "form": "inverse", "gravity": "upright"},
    "inverse, heavy link": {
        "truth": _HEAVY, "form": "inverse", "joints": 2, "gravity": "upright",
    },
    "random, inertia of the rotor": {
        "truth": _changed("joint", "j1", armature=0.09), "form": "random",
    },
    "random, weak servo": {"truth": _weak, "form": "random", "joints": 2, "drive": "servo"},
    "free, damping": {"truth": _DAMPED, "form": "free", "gravity": "upright"},
    "real servo": {"real": "xl330/xl330_kp100"},
}  # fmt: skip
"""Recordings that `loose gap` explains, by name."""


def write_gap_recording(
    folder: Path,
    *,
    truth: Callable[[Any], None] = lambda spec: None,
    form: str = "forward",
    joints: int = 1,
    gravity: str = "flat",
    drive: str = "motor",
    late: float = 0.0,
) -> None:
    """Three short runs of a simulated arm that differs from its model, with sensor noise."""
    driven = "none" if form == "free" else drive
    nominal = _arm(joints, gravity=gravity, drive=driven)
    spec = mujoco.MjSpec.from_string(nominal)
    truth(spec)
    model = spec.compile()
    rng = np.random.default_rng(1)
    moment = np.arange(600) * _STEP
    own = [int(model.joint(f"j{k + 1}").dofadr[0]) for k in range(joints)]
    places = [int(model.joint(f"j{k + 1}").qposadr[0]) for k in range(joints)]
    lag = round(late / _STEP)
    runs = []
    for number in range(3):
        commands = _commands(form, drive, joints, number, moment, rng)
        data = mujoco.MjData(model)
        if form == "free":
            data.qpos[places] = 0.5 + 0.2 * number
        read = np.zeros((len(moment), joints + 3))
        torque = np.zeros((len(moment), joints))
        for i in range(len(moment)):
            if model.nu:
                data.ctrl[:] = commands[max(i - lag, 0)]
            mujoco.mj_step(model, data)
            read[i] = data.sensordata
            torque[i] = data.qfrc_actuator[own]
        read += rng.normal(0, [2e-5] * joints + [0.02] * 3, read.shape)
        torque += rng.normal(0, 2e-3, torque.shape)
        sensors = {f"q{k + 1}": read[:, k] for k in range(joints)}
        runs.append(
            Run(
                name=f"run-{number}.csv",
                time=moment,  # type: ignore[arg-type]
                controls={f"m{k + 1}": commands[:, k] for k in range(joints)}
                if form in ("forward", "random")
                else {},
                torques={f"j{k + 1}": torque[:, k] for k in range(joints)}
                if form == "inverse"
                else {},
                sensors=sensors if form == "inverse" else sensors | {"acc": read[:, joints:]},
            )
        )
    write_recording(folder, model_xml=nominal, runs=runs, file_format="csv")


def _commands(
    form: str, drive: str, joints: int, number: int, moment: Any, rng: np.random.Generator
) -> Any:
    """Commands of a run (samples, joints)."""
    from scipy import signal

    size = np.array([4.0, 1.5])[:joints] if drive == "motor" else np.array([0.4, 0.6])[:joints]
    ramp = np.minimum(4 * moment, 1.0)[:, None]
    if form == "random":
        band = signal.butter(2, 15.0 if drive == "motor" else 2.0, fs=1 / _STEP, output="sos")
        noise = signal.sosfilt(band, rng.normal(size=(len(moment), joints)), axis=0)
        return size * ramp * noise / noise.std(axis=0)
    rates = (3 + 2 * number) * np.array([1.0, 1.7])[:joints]
    return size * ramp * np.sin(np.outer(moment, rates))


def gap(names: Sequence[str] | None = None) -> dict[str, Any]:
    """What `loose gap` finds in each recording."""
    found = {}
    for name in names or GAPS:
        given = GAPS[name]
        with tempfile.TemporaryDirectory() as place:
            if "real" in given:
                folder = MEASURED / given["real"]
                if not folder.is_dir():
                    continue
            else:
                folder = Path(place) / "recording"
                write_gap_recording(folder, **given)
            out = Path(place) / "found"
            _loose("gap", str(folder), "--out", str(out), "--threads", "1")
            found[name] = _gap_figures(json.loads((out / "result.json").read_text("utf-8")))
    return found


def _gap_figures(result: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "verdict": result["verdict"],
        "effects": [
            {
                "kind": e["kind"],
                "where": e["where"],
                "variant": e["variant"],
                "parameters": _digits(e["parameters"]),
                "interval": _digits(e["interval_95"]),
                "confusable": sorted(
                    str({key: each[key] for key in ("kind", "where")})
                    for each in e["ambiguous_with"]
                ),
                "probability": _digits(e["probability"]),
            }
            for e in result["effects"]
        ],
        "before": _digits(result["gap"]["before"]),
        "after": _digits(result["gap"]["after"]),
        "channels": {each["channel"]: each["verdict"] for each in result["channels"]},
        "pulled": {each["name"]: _digits(each["deviations"]) for each in result["pulled"]},
    }


def _loose(*words: str) -> None:
    """Run a command of `loose` in this process, silently."""
    said = io.StringIO()
    with (
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        code = loose([*words])
    if code:
        raise RuntimeError(f"loose {' '.join(words)} ended with {code}:\n{said.getvalue()[-2000:]}")


# ------------------------------------------------------------- recordings of loose diagnose

DIAGNOSES = {"healthy": False, "loose link 3": True}
"""Sessions that `loose diagnose` judges: whether something is loose."""


def instrument(names: Sequence[str] | None = None) -> dict[str, Any]:
    """What `loose diagnose` finds in each session, without and with a reference."""
    found: dict[str, Any] = {}
    for name in names or DIAGNOSES:
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place) / "recording"
            loose_arm(folder, loose=DIAGNOSES[name], reference=True)
            for way in ("--no-reference", ""):
                out = Path(place) / f"found{way}"
                _loose("diagnose", str(folder), "--out", str(out), *([way] if way else []))
                result = json.loads((out / "result.json").read_text("utf-8"))
                places = [
                    {
                        "place": f"{each['kind']}@{each['at']}",
                        "verdict": each["verdict"],
                        "rhythm": _digits(each["rhythm"]),
                        "tested": _digits(each["tested"]),
                    }
                    for each in result["places"]
                ]
                found[f"{name}, {'alone' if way else 'reference'}"] = {
                    "verdict": result["verdict"],
                    "evidence": _digits(result["evidence"]),
                    "places": places,
                }
    return found


def plan() -> dict[str, Any]:
    """What `loose plan` asks for first."""
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "plan"
        _loose("plan", str(DESK_ARM), "--out", str(out), "--controller", "ros2_jtc")
        files = sorted(f.name for f in out.iterdir() if f.is_file())
        asked = json.loads((out / "plan.json").read_text("utf-8"))
    runs = [[_digits(each["pose"]), _digits(each["peak"])] for each in asked["runs"]]
    kept = {"runs": runs, "tested": _digits(asked["tested"]), "lines": asked["signal"]["excited"]}
    return {"files": files, "plan": kept}


# ------------------------------------------------------------------------------- thesis


def thesis(page: Path | None = None) -> dict[str, Any]:
    """Numbers that the reproduction of the thesis prints, by section of its page."""
    if page is not None:
        return thesis_figures(page.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as place:
        script = str(ROOT / "scripts" / "reproduce_thesis.py")
        subprocess.run([sys.executable, script, "--out", place], cwd=ROOT, check=True)
        return thesis_figures((Path(place) / "index.html").read_text(encoding="utf-8"))


def thesis_figures(text: str) -> dict[str, Any]:
    """Cells of the tables, and numbers of the paragraphs and captions, by section."""
    found = {}
    for key, body in re.findall(r'<section id="(\w+)">(.*?)</section>', text, re.DOTALL):
        body = re.sub(r"<(svg|style|script)\b.*?</\1>", " ", body, flags=re.DOTALL)
        rows = re.findall(r"<tr\b[^>]*>(.*?)</tr>", body, re.DOTALL)
        tables = [
            [_text(cell) for cell in re.findall(r"<t[dh]\b[^>]*>(.*?)</t[dh]>", row, re.DOTALL)]
            for row in rows
        ]
        prose = _text(re.sub(r"<table\b.*?</table>", " ", body, flags=re.DOTALL))
        numbers = re.findall(r"[-−+±]?\d[\d,]*(?:\.\d+)?(?:[eE][-+]?\d+)?", prose)
        found[key] = {"rows": [" | ".join(row) for row in tables], "numbers": " ".join(numbers)}
    return found


def _text(markup: str) -> str:
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", markup)).split())


# --------------------------------------------------------------------- compare and rewrite

PARTS: dict[str, Callable[..., dict[str, Any]]] = {
    "environments": environments,
    "gap_environment": gap_environment,
    "agents": agents,
    "posterior": posterior,
    "gap": gap,
    "instrument": instrument,
    "plan": plan,
    "thesis": thesis,
}
"""Parts of the golden results, by name."""

# Another processor may round another way, and a simulation carries that on.
RELATIVE, ABSOLUTE = 1e-4, 1e-5
FITTED = 2e-2  # a search ends where it no longer gains
SEARCHED = ("gap", "instrument")
BITS = "bits"
"""Key of digests: they hold on one processor, and are compared where it is asked for."""


def kept(part: str) -> dict[str, Any]:
    """A part as it is kept: the figures and the reason of their last change."""
    found: dict[str, Any] = json.loads((FOLDER / f"{part}.json").read_text(encoding="utf-8"))
    return found


def _leaves(tree: Any, place: str) -> Iterator[tuple[str, Any]]:
    """Values of a tree by their places; an empty branch is a value."""
    branches = tree.items() if isinstance(tree, dict) else enumerate(tree)
    form = "{}.{}" if isinstance(tree, dict) else "{}[{}]"
    for key, part in branches:
        own = form.format(place, key)
        yield from _leaves(part, own) if part and isinstance(part, dict | list) else [(own, part)]


def differences(
    before: Any, now: Any, place: str, *, relative: float = RELATIVE, bits: bool = False
) -> list[str]:
    """Places where two trees differ; numbers by more than rounding."""
    old, new = dict(_leaves(before, place)), dict(_leaves(now, place))
    found = []
    for own in dict.fromkeys([*old, *new]):
        a, b = (each.get(own, "nothing") for each in (old, new))
        if a == b or (own.endswith(f".{BITS}") and not bits):
            continue
        number = isinstance(a, float) and isinstance(b, int | float)
        absolute = ABSOLUTE if relative else 0.0
        if not (number and np.isclose(b, a, rtol=relative, atol=absolute, equal_nan=True)):
            found.append(f"{own}: {a} before, {b} now")
    return found


CARRIED = ("environments", "agents", "posterior", "thesis")
"""Parts that are compared whole on processors that round alike: contact carries rounding on."""
_SHAKEN = ("experiment_five", "experiment_six", "vera_link_finding")
"""Sections of the thesis that shake a loose arm."""


@functools.cache
def rounds_alike() -> bool:
    """Whether this processor rounds as the one on which the figures were kept.

    By the last bit of records that are long enough for a loose part to carry rounding on.
    """
    env: Any = gymnasium.make_vec(ROUNDED, num_envs=WIDTH)
    own = kept("environments")["found"][f"{ROUNDED} {{}}"]["vector"][BITS]
    return bool(_played(env, list(range(SEED, SEED + WIDTH)), WIDTH)[0][BITS] == own)


def comparable(part: str, found: Mapping[str, Any]) -> dict[str, Any]:
    """What every processor gives: a loose part carries rounding on, from its first knocks.

    Of the environments all but the records; no whole episode of an agent, and no posterior; of the
    thesis what does not shake a loose arm.
    """
    if part in ("agents", "posterior"):
        return {}
    if part == "thesis":
        return {name: each for name, each in found.items() if name not in _SHAKEN}
    if part != "environments":
        return dict(found)
    return {
        name: {
            key: each | {"observations": each["observations"][:1]}
            for key, each in traces.items()
        }
        for name, traces in found.items()
    }  # fmt: skip


def only_comparable(part: str, *, exact: bool) -> bool:
    """Whether a part is compared only as far as any processor agrees."""
    return part in CARRIED and not exact and not rounds_alike()


def compare(part: str, now: Mapping[str, Any], *, exact: bool = False) -> list[str]:
    """Differences between the kept figures of a part and those of now.

    ``exact`` compares digests too, and all kept digits. What could not be computed here, as the
    recordings of real machines where there are none, is left out, as is what another processor
    need not give (`comparable`).
    """
    before = kept(part)["found"]
    if only_comparable(part, exact=exact):
        before, now = comparable(part, before), comparable(part, now)
    if part == "gap":
        before = {name: each for name, each in before.items() if name in now}
    relative = 0.0 if exact else FITTED if part in SEARCHED else RELATIVE
    fresh = json.loads(json.dumps(now))
    return differences(before, fresh, part, relative=relative, bits=exact)


def write(part: str, now: Mapping[str, Any], because: str) -> None:
    """Keep the figures of a part from now on."""
    file = FOLDER / f"{part}.json"
    fresh = json.loads(json.dumps(now))
    if file.is_file():
        old = kept(part)
        if old["found"] == fresh:
            return
        if old["because"] == because:
            raise InvalidSetting(
                f"{part}: {because!r} was the reason of an earlier change; give CHANGELOG.md a "
                "line on this one"
            )
        if part == "gap":
            fresh = old["found"] | fresh
    _check_said(because, (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"))
    lines = [
        f"{json.dumps(name)}:{json.dumps(each, separators=(',', ':'), ensure_ascii=False)}"
        for name, each in fresh.items()
    ]
    text = f'{{"because":{json.dumps(because)},\n"found":{{\n' + ",\n".join(lines) + "\n}}\n"
    write_text(file, text)


def _check_said(because: str, changelog: str) -> None:
    """Refuse words that do not stand under what is not released yet."""
    parts = re.split(r"^(?=## )", changelog, flags=re.MULTILINE)
    new = " ".join(part for part in parts if "unreleased" in part.partition("\n")[0].lower())
    if not because or because not in " ".join(new.split()):
        raise InvalidSetting(
            f"CHANGELOG.md does not say {because!r} under what is unreleased; put it there first, "
            "for those whose figures change"
        )


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Parts that are computed, and what is done with them."""

    parts: Positional[tuple[Annotated[str, one_of(tuple(PARTS))], ...]] = ()
    """Parts; all by default."""
    page: Path | None = None
    """Page of the thesis that is there already."""
    exact: bool = False
    """Compare to the last kept digit."""
    because: str | None = None
    """Write anew; the words of the line in CHANGELOG.md."""


def run(given: Settings) -> None:
    """Compute parts, and compare or write them; exit code 1 where they differ."""
    differ = False
    for part in given.parts or PARTS:
        begin = time.process_time()
        now = thesis(given.page) if part == "thesis" else PARTS[part]()
        seconds = time.process_time() - begin
        if given.because is not None:
            write(part, now, " ".join(given.because.split()))
            print(f"{part}: kept ({seconds:.0f} CPU s)", flush=True)
            continue
        found = compare(part, now, exact=given.exact)
        differ |= bool(found)
        limited = ""
        if only_comparable(part, exact=given.exact):
            limited = ", as far as a processor that rounds otherwise can say"
        print(f"{part}: {f'{len(found)} differences' if found else 'same'}{limited} "
              f"({seconds:.0f} CPU s)")  # fmt: skip
        print("".join(f"  {line}\n" for line in found[:20]), end="", flush=True)
    if differ:
        sys.exit(1)


if __name__ == "__main__":
    command("golden", __doc__, Settings, run)
