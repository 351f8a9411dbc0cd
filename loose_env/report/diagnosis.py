"""Report of a diagnosis as text, HTML and page: what knocks, what to do, what was not tested."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from loose_env.arms import Arm, arm_from_file
from loose_env.envs import INK, MEASURED, MUTED, TRUTH, ArmDrawing
from loose_env.errors import InvalidData, LooseEnvError, MissingExtra
from loose_env.faults import Backlash, StructuralLooseness
from loose_env.instrument import (
    BOLTS,
    MODEL,
    RECORDING,
    Diagnosis,
    Place,
    RunSeen,
    knock_limit,
    read_plan,
)
from loose_env.io import begun, sentence, write_text
from loose_env.report import figures
from loose_env.report.figures import labels, legend
from loose_env.report.page import Brief, FigureCard, Section, Table, render_page, warnings_section
from loose_env.report.words import light_colours, path_word, percent, place_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_EVIDENCE = {
    "knocks": ("Evidence for the knocks of the best place", " nats", ""),
    "rhythm": ("Correlation of the best place's foretold knocks with what was heard", "", ""),
    "chance": ("Correlation of some place with what was heard at other times", "", ""),
    "top_db": ("Rise of the ringing over the healthy session", " dB", "top_db"),
    "even_db": ("Rise of the even lines", " dB", ""),
    "odd_db": ("Rise of the odd lines left out", " dB", ""),
    "stiff": ("Growth of the tool's motion that the healthy gears leave", "", "stiff"),
    "payload_kg": ("Mass at the tool that would explain it", " kg", ""),
    "friction": ("Correlation of the friction's rhythm with it", "", ""),
    "gears_left": ("Share of the tool's slow motion that the model leaves", "", ""),
}
"""Statistic -> its words, unit, and the setting that is its limit."""
_FLOOR = 1e-4  # share of the highest line below which none is drawn


def diagnosis_headline(d: Diagnosis) -> str:
    """Outcome of a diagnosis in one sentence."""
    return sentence(d.headline)


def diagnosis_text(d: Diagnosis, *, folder: str = "") -> str:
    """Diagnosis in a few lines for a terminal; `folder`: the recording's path, for commands."""
    return _brief(d, folder).text()


def diagnosis_html(d: Diagnosis, *, folder: str = "") -> str:
    """Diagnosis as a fragment of HTML for a notebook, without style sheet of its own."""
    return _brief(d, folder).html()


def _brief(d: Diagnosis, folder: str) -> Brief:
    rows, loose = place_table(d).rows, d.verdict != "tight"
    cells: list[Any] = [list(rows[0]), *(list(row.values()) for row in rows)] if rows else []
    return Brief(
        headline=diagnosis_headline(d),
        parts=[
            ("Next", "next: ", [sentence(d.remedy)]),
            ("Commands", "  ", diagnosis_commands(d, folder)),
            ("", "  ", cells),
            ("Reasons", "because: " if loose else "nearest: ", [sentence(w) for w in d.reasons]),
            ("Remarks", "note: ", _remarks(d)),
        ],
    )


def _remarks(d: Diagnosis) -> list[str]:
    """Remarks as sentences; the name of a file stays as it is."""
    files = tuple(run.file for run in d.runs)
    many = ((words, sentence(words)) for words in dict.fromkeys(d.remarks))
    return [w[:1] + said[1:] if files and w.startswith(files) else said for w, said in many]


def diagnosis_commands(d: Diagnosis, recording: str = "", result: str = "") -> list[str]:
    """Commands of the next step, by the paths of the recording and of the result's folder."""
    own = Path(recording or f"session/{RECORDING}")
    session = own.parent if own.name == RECORDING else own.with_name(f"{own.name}-next")
    known = result or str(session / "diagnosis")
    again = f"loose diagnose {path_word(session / RECORDING)} --out {path_word(known)}"
    if d.verdict == "refused":
        return [f"loose doctor {path_word(own)}", again.replace(str(session / RECORDING), str(own))]
    model = path_word(own / MODEL)
    if d.hobby:
        return [f"loose trend EARLIER {path_word(own)} --out trend"]
    if d.settled:
        return [
            f"loose plan {model} --out session-after --like {path_word(own)}",
            f"loose diagnose session-after/{RECORDING} --out session-after/diagnosis",
        ]
    if d.verdict == "tight" and not d.untested:
        return []
    if d.verdict == "open":
        return [again]
    planned = f"loose plan {model} --out {path_word(session)} --known {path_word(known)}"
    return [planned, again]


def write_diagnosis(
    folder: Path,
    d: Diagnosis,
    model_path: str | Path,
    *,
    recording: str,
    given: str = "",
    say: Callable[[str], None] = print,
) -> list[Path]:
    """Write ``report.html`` and ``result.json``, the result last.

    What was found is written also where the page cannot be drawn.

    Parameters
    ----------
    folder : Path
        Where they go; made where there is none.
    d : Diagnosis
        Result.
    model_path : str or Path
        Model of the recording, for the picture of the arm.
    recording, given : str
        Name of the recording, for the head of the page; its path as typed, for the commands.
    say : callable
        Receives the reason why there is no page.
    """
    written, page, here = [], folder / "report.html", Path.cwd()
    result = str(folder.relative_to(here) if folder.is_relative_to(here) else folder)
    (folder / "result.json").unlink(missing_ok=True)
    try:
        html = _page(d, Path(model_path), recording, diagnosis_commands(d, given, result))
        written.append(write_text(page, html))
    except MissingExtra as error:
        page.unlink(missing_ok=True)  # that of an earlier result
        say(f"no report.html: {error}")
    written.append(d.write(folder / "result.json"))  # last: it says that all is there
    return written


def _page(d: Diagnosis, model: Path, recording: str, commands: Sequence[str]) -> str:
    cards, left_out = _cards(d, model)
    type_in = "After the repair, with the first plan's options:" if d.settled else "Type:"
    doctor = [f"{f.run}: {f.found}. {f.remedy}" for f in d.preflight if f.severity == "error"]
    return render_page(
        diagnosis_headline(d),
        [
            Section(
                heading="What to do next",
                points=[sentence(d.remedy), *([type_in] if commands else [])],
                code="\n".join(commands),
            ),
            Section(heading="Links and joints", tables=[place_table(d)]),
            Section(heading="Pictures", intro=left_out, cards=cards),
            Section(
                heading="What came nearest" if d.verdict == "tight" else "Reasons",
                points=[sentence(words) for words in d.reasons],
            ),
            Section(heading="Remarks", points=_remarks(d)),
            warnings_section(("critical", words) for words in doctor),
            Section(heading="Numbers", tables=[_evidence_table(d)]),
            Section(heading="Runs", tables=[_runs_table(d)]),
        ],
        kicker=[recording, "diagnosis of a loose link or joint", d.date[:10]],
        text=_summary(d),
        notes=_notes(d),
        colours=light_colours(d),
    )


def _summary(d: Diagnosis) -> list[str]:
    used = [r for r in d.runs if r.used and r.condition == "suspect"]
    healthy = len([r for r in d.runs if r.used and r.condition == "healthy"])
    beside = f"compared with {healthy} healthy ones" if d.reference else "no healthy session beside"
    said = [f"Runs: {len(used)} of the arm under test, {beside}; {d.shaken_s:.0f} s of shaking."]
    top = d.places[0] if d.places else None
    if top is not None and top.verdict in ("loose", "suspect"):
        said.insert(0, f"{begun(top.words)}: {percent(top.probability)}, if one place is loose.")
    if d.hobby:
        said.append(
            "Every arm of this class has play from the start: only a change over months tells."
        )
    return said


def _evidence_table(d: Diagnosis) -> Table:
    rows = []
    for name, value in d.evidence.items():
        words, unit, setting = _EVIDENCE.get(name, (name, "", ""))
        limit = d.settings.get(setting)
        if name == "knocks" and "healthy" in d.settings:
            limit = round(knock_limit(len(d.places), d.settings["healthy"]), 2)
        rows.append(
            {
                "Statistic": words,
                "Value": f"{value:.2f}{unit}" if np.isfinite(value) else "-",
                "Limit": f"{limit:g}{unit}" if isinstance(limit, (int, float)) else "-",
            }
        )
    return Table(rows=rows)


def _runs_table(d: Diagnosis) -> Table:
    rows = [
        {
            "File": run.file,
            "Arm": "healthy" if run.condition == "healthy" else "under test",
            "Used": "yes" if run.used else "no",
            "Repeats": f"{run.repeats:.2f}" if run.used else "-",
            **({"Reason": run.why or "-"} if any(r.why for r in d.runs) else {}),
        }
        for run in d.runs
    ]
    return Table(
        rows=rows,
        note="Repeats: correlation of what was heard between periods; 1 is the same every time.",
    )


def _notes(d: Diagnosis) -> list[str]:
    settings = ", ".join(f"{k} {v}" for k, v in d.settings.items() if not isinstance(v, dict))
    measured = f"Measured {d.date}. " if d.date else ""
    by = " ".join(filter(None, ["loose-env", d.version]))
    return [
        f"{measured}Diagnosed by {by} in {d.seconds:.0f} s of processor time. Model: {d.model}. "
        "All numbers stand in result.json.",
        *([f"Settings: {settings}."] if settings else []),
    ]


# Pictures


def _cards(d: Diagnosis, model: Path) -> tuple[list[FigureCard], list[str]]:
    """The pictures that convince, and sentences about those that are left out."""
    runs = sorted((r for r in d.runs if r.used and r.condition == "suspect"), key=_agreement)[::-1]
    cards, said = [], []
    if not runs:
        return [], []
    if any(run.heard for run in runs):
        told = bool(runs[0].foretold)
        caption = (
            "Envelope of the top band at the tool over one period of the signal, and the knocks "
            f"that {d.places[0].words} would make if it were loose, at the best scale. The two "
            "poses that agree best."
            if told
            else "Envelope of the top band at the tool over one period of the signal. The knocks "
            "of no place fit it."
        )
        title = "Rhythm foretold and heard" if told else "What was heard"
        figure = _rhythm_figure([run for run in runs if run.heard][:2])
        cards.append(FigureCard(title=title, image=figure, caption=caption))
    lined = next((run for run in runs if run.lines and max(run.lines) > 0), None)
    if lined is not None:
        excited = _excited(model)
        what = (
            "Excited lines answer the commands; all others are distortion, which knocks and "
            "friction make."
            if excited
            else "Even lines are never excited: they are distortion, of knocks and friction."
        )
        beside = (
            " Grey: the same pose on the healthy day; what rose above it is new."
            if lined.healthy_lines
            else " There is no healthy session to compare with."
        )
        cards.append(
            FigureCard(
                title=f"Lines of the tool, {lined.file}",
                image=_lines_figure(lined, excited),
                caption=what + beside,
            )
        )
    suspected = d.places[0] if d.places and d.places[0].verdict in ("loose", "suspect") else None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of hypotheses of the environments
            arm = arm_from_file(model)
        figure = arm_figure(arm, runs[0].pose, suspected)
        marked = f"Marked: {suspected.words}." if suspected else "Nothing is suspected."
        names = ", ".join(f"{k} {name}" for k, name in enumerate(arm.joints, 1))
        caption = f"{marked} Joints from the base: {names}."
        cards.append(FigureCard(title=f"The arm, {runs[0].file}", image=figure, caption=caption))
    except (LooseEnvError, OSError) as error:
        said.append(f"The arm is not drawn: {sentence(str(error))}")
    return cards, said


def _agreement(run: RunSeen) -> float:
    """Correlation of foretold and heard; how well it repeats where nothing is foretold."""
    if not run.foretold or not run.heard:
        return run.repeats - 1.0
    both = np.array([run.heard, run.foretold])
    return float(np.nan_to_num(np.corrcoef(both)[0, 1])) if both.std(1).min() > 0 else -1.0


def _period(run: RunSeen) -> float:
    return 1.0 / run.lines_hz[0] if run.lines_hz and run.lines_hz[0] > 0 else 1.0


def _rhythm_figure(runs: Sequence[RunSeen]) -> Figure:
    """Amplitude of the top band over a period, a panel for each run."""
    figure, many = figures.panels(len(runs), 1.7, rows=1)
    for axes, run in zip(many, runs, strict=True):
        time = np.arange(len(run.heard)) * _period(run) / len(run.heard)
        axes.fill_between(time, run.heard, color=MEASURED, alpha=0.22, linewidth=0)
        axes.plot(time, run.heard, color=MEASURED, linewidth=1.4, label="heard")
        agree = ""
        if run.foretold:
            axes.plot(time, run.foretold, color=TRUTH, linewidth=1.6, label="foretold")
            agree = f", correlation {_agreement(run):.2f}"
        axes.set_xlim(0, _period(run))
        axes.set_ylim(bottom=0)
        labels(axes, above=f"{run.file}: top band [m/s²]{agree}")
    labels(many[-1], x="time in the period [s]")
    legend(figure, many[0])
    return figure


def _excited(model: Path) -> frozenset[int]:
    """Numbers of the excited lines, by the plan beside the model; empty where there is none."""
    try:
        return frozenset(read_plan(model.parent).signal.excited)
    except (InvalidData, OSError):
        return frozenset()


def _lines_figure(run: RunSeen, excited: frozenset[int]) -> Figure:
    """Amplitude of the tool's lines: excited ones and distortion, over those of a healthy day."""
    figure, (axes,) = figures.panels(1, 3.0, rows=2)
    hertz, now = np.array(run.lines_hz), np.array(run.lines)
    number = np.round(hertz * _period(run)).astype(int)
    driven = np.isin(number, list(excited)) if excited else number % 2 == 1
    floor = _FLOOR * float(now.max())
    if run.healthy_lines:
        then = np.maximum(run.healthy_lines, floor)
        look: dict[str, Any] = {"color": MUTED, "linewidth": 1.2}
        axes.plot(hertz, then, label="healthy day", linestyle=figures.DASHED, **look)
    names = ("excited lines", "distortion") if excited else ("odd lines", "even lines: distortion")
    for own, colour, mark, name in (
        (driven, MEASURED, "o", names[0]),
        (~driven, TRUTH, "D", names[1]),
    ):
        y = np.maximum(now[own], floor)
        axes.vlines(hertz[own], floor, y, color=colour, linewidth=1.0, alpha=0.55)
        axes.plot(hertz[own], y, mark, color=colour, markersize=3.4, label=name)
    axes.set_yscale("log")
    figures.plain_log_ticks(axes, "y")
    labels(axes, x="frequency [Hz]", above="acceleration of the tool [m/s²]")
    legend(figure, axes)
    return figure


def arm_figure(arm: Arm, pose: Mapping[str, float], suspected: Place | None) -> Figure:
    """Draw an arm in a pose, with the suspected seat or joint in the colour of a fault."""
    places = arm.seat_bodies if suspected and suspected.kind == BOLTS else arm.joints
    number = 0
    fault: Backlash | StructuralLooseness | None = None
    if suspected is not None and suspected.base:
        number = 1
    elif suspected is not None:
        if suspected.at not in places:
            raise InvalidData(f"{arm.name} has no {suspected.at}; it has {', '.join(places)}")
        number = places.index(suspected.at) + 1
        if suspected.kind != BOLTS:
            fault = Backlash(joint=number, gap=0.0, stiffness=(1.0, 1.0))
        elif suspected.direction is not None:
            fault = StructuralLooseness(
                link=number, direction=suspected.direction, gap=0.0, stiffness=(1.0, 1.0)
            )
    seat = suspected is not None and suspected.kind == BOLTS
    figure, drawing = figures.new_figure(4.6), ArmDrawing(arm)
    axes = figure.add_axes((0.0, 0.0, 1.0, 0.92))
    at = np.array([float(pose.get(name, 0.0)) for name in arm.joints])
    drawing.draw(axes, drawing.marks(at, loose=[number] if seat else [], fault=fault))
    figure.text(0.97, 0.03, drawing.seen, color=MUTED, fontsize=9, ha="right")
    if suspected is not None:
        mark = "s" if seat else "o"
        axes.plot([], [], color=TRUTH, marker=mark, linestyle="", label=suspected.words[4:])
        if seat and fault is not None:
            label = "the way it slides"
            axes.plot([], [], color=INK, marker="$↔$", linestyle="", label=label)
        legend(figure, axes)
    return figure
