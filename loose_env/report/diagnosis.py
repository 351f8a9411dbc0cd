"""Report of a diagnosis as text, HTML and pages: headline, next steps, hypotheses, runs."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.arms import Arm
from loose_env.errors import InvalidData, MissingExtra
from loose_env.instrument import (
    HEALTHY,
    PROBABLE,
    Diagnosis,
    NextMeasurement,
    RecordSeen,
    Trend,
    path_word,
    read_recorded_arm,
)
from loose_env.io import begun, sentence, write_text
from loose_env.report.diagnosis_figures import (
    arm_figure,
    loop_figure,
    posterior_figure,
    shown_hypotheses,
    transmission_cards,
)
from loose_env.report.page import (
    Brief,
    FigureCard,
    Section,
    Table,
    graded_parts,
    named_list,
    render_page,
    warnings_section,
)
from loose_env.report.trend import write_trend_page
from loose_env.report.words import (
    joint_words,
    link_words,
    percent,
    position_text,
    short_name,
    slides,
    with_plain_names,
)

_HEADLINE = 44  # letters of a hypothesis in the headline, at most
_LISTED, _RANKED = 1e-3, 6  # probability from which a hypothesis is listed, and their number
_LOOPS, _BARS = 12, 24  # records whose loops and whose posterior are drawn
_COLUMNS = (
    "Direction: unit vector in the link's frame, half opening of its 95 % cone. Free travel: from "
    "stop to stop, with 95 % interval. Runs: those that raised the probability. Two faults at "
    "once, or one of another kind, are no hypothesis."
)


def diagnosis_headline(diagnosis: Diagnosis, arm: Arm) -> str:
    """Outcome of a diagnosis in one line, worded by the verdict and its probability.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.instrument import Fault
    >>> found = Diagnosis(
    ...     fault=Fault(kind="healthy"),
    ...     probability=1.0,
    ...     posterior={"healthy": 1.0},
    ...     verdict="model_mismatch",
    ... )
    >>> diagnosis_headline(found, planar(2))
    'The model is not that of this arm: correct it first.'
    """
    said = short_name(arm, diagnosis.fault.hypothesis)
    if len(said) > _HEADLINE:  # the number alone: the name stands below the headline
        said = re.sub(r" \([^()]*\)", "", said)
    if diagnosis.verdict == "model_mismatch":
        return "The model is not that of this arm: correct it first."
    if diagnosis.verdict != "open":
        return f"{begun(said)}."
    probability = diagnosis.probability
    if diagnosis.fault.kind == HEALTHY and np.isfinite(diagnosis.nothing_opened):
        probability = diagnosis.nothing_opened  # as the verdict has it
    if probability >= PROBABLE:
        return f"Probably {said}."
    return f"Not decided. Most likely so far: {said}."


def _brief(diagnosis: Diagnosis, arm: Arm, folder: str, *, warnings: bool) -> Brief:
    names = {name: short_name(arm, name) for name in diagnosis.posterior}
    table = hypothesis_table(diagnosis, arm)
    cells: list[list[Any]] = [table.columns, *(list(row.values()) for row in table.rows)]
    for row, share in zip(cells, ["", *(p for _, p in _listed(diagnosis))], strict=True):
        row.insert(1, share)
    graded = [(s, with_plain_names(w, names)) for s, w in diagnosis.graded_warnings]
    return Brief(
        headline=diagnosis_headline(diagnosis, arm),
        parts=[
            ("", "  ", cells),
            ("Open", "open: ", _reasons(diagnosis, arm)),
            ("Next", "next: ", diagnosis_steps(diagnosis, arm)),
            ("Next measurement", "  ", _measurement(diagnosis, arm)),
            ("Commands", "  ", _commands(diagnosis, folder)),
            *(graded_parts(graded) if warnings else []),
        ],
    )


def diagnosis_text(
    diagnosis: Diagnosis, arm: Arm, *, folder: str = "", warnings: bool = True
) -> str:
    """Diagnosis in a few lines of text.

    Parameters
    ----------
    diagnosis : Diagnosis
        Result.
    arm : Arm
        The nominal arm that it was found with.
    folder : str
        Path of the recording, for commands to be typed.
    warnings : bool
        True to end with the warnings.
    """
    return _brief(diagnosis, arm, folder, warnings=warnings).text()


def diagnosis_html(diagnosis: Diagnosis, arm: Arm, *, folder: str = "") -> str:
    """Diagnosis as a fragment of HTML, with the probabilities drawn as bars.

    Parameters
    ----------
    diagnosis, arm, folder
        As for `diagnosis_text`.
    """
    return _brief(diagnosis, arm, folder, warnings=True).html()


def write_diagnosis(
    folder: Path,
    diagnosis: Diagnosis,
    model: Path,
    *,
    recording: str = "",
    given: str = "",
    trend: Trend | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> list[Path]:
    """Write the pages and ``result.json``, the result last.

    An earlier result never stands beside a later page. What was found is written also where the
    page cannot be drawn.

    Parameters
    ----------
    folder : Path
        Where they go; made where there is none.
    diagnosis : Diagnosis
        Result.
    model : Path
        Model of the recording.
    recording : str
        Name of the recording, for the head of the page.
    given : str
        Its folder as the reader would type it, for commands on the page.
    trend : Trend, optional
        Change since earlier sessions: ``trend.html`` and ``trend.json`` too.
    say : callable
        Receives the reason why there is no page.

    Returns
    -------
    list of Path
        The files written.
    """
    written = []
    page = folder / "report.html"
    for name in ("result.json", "trend.json", "trend.html"):
        (folder / name).unlink(missing_ok=True)
    try:
        arm = read_recorded_arm(model).shown
        written.append(write_page(page, diagnosis, arm, recording=recording, folder=given))
        if trend is not None:
            written.append(write_trend_page(folder / "trend.html", trend, recording=recording))
    except (MissingExtra, InvalidData) as error:
        page.unlink(missing_ok=True)  # that of an earlier result
        say(f"no report.html: {error}")
    if trend is not None:
        written.append(trend.write(folder / "trend.json"))
    written.append(diagnosis.write(folder / "result.json"))  # last: it says that all is there
    return written


def write_page(
    path: str | os.PathLike[str],
    diagnosis: Diagnosis,
    arm: Arm,
    *,
    recording: str = "",
    folder: str = "",
) -> Path:
    """Write the page of a diagnosis.

    Parameters
    ----------
    path : path-like
        Path of the page; its folder is made if missing.
    diagnosis : Diagnosis
        Diagnosis.
    arm : Arm
        The nominal arm that it was found with.
    recording : str
        Name of the recording, for the head of the page.
    folder : str
        Path of the recording, for commands to be typed.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    InvalidData
        If the diagnosis names a joint or a link that the arm does not have.
    MissingExtra
        If jinja2 or matplotlib is not installed.
    """
    commands = _commands(diagnosis, folder or recording)
    page = render_page(
        diagnosis_headline(diagnosis, arm),
        [
            Section(
                heading="What to do next",
                points=diagnosis_steps(diagnosis, arm),
                code="\n".join(commands),
            ),
            Section(heading="Hypotheses", tables=[hypothesis_table(diagnosis, arm)]),
            Section(
                heading="Measured and predicted transmission",
                cards=transmission_cards(diagnosis, arm),
            ),
            warnings_section(diagnosis.graded_warnings),
            Section(
                heading="Arm and probabilities",
                cards=[_arm_card(diagnosis, arm), *_posterior_cards(diagnosis, arm)],
            ),
            _next_section(diagnosis, arm),
            _loops_section(diagnosis, arm),
            _records_section(diagnosis, arm),
        ],
        kicker=[recording, "diagnosis of a loose link or joint", diagnosis.date[:10]],
        text=summary_words(diagnosis, arm),
        notes=_notes(diagnosis, arm),
    )
    return write_text(Path(path), page)


def hypothesis_table(diagnosis: Diagnosis, arm: Arm) -> Table:
    """The one table of a diagnosis, most probable hypothesis first."""
    kept = _listed(diagnosis)
    rows = [
        {
            "Hypothesis": begun(short_name(arm, name)),
            "Probability": percent(p),
            "Direction": _direction_words(diagnosis, name),
            "Free travel": travel_words(diagnosis, arm)
            if name == diagnosis.fault.hypothesis
            else "–",
            "Runs": _runs(diagnosis, name),
        }
        for name, p in kept
    ]
    note, left = [data_words(diagnosis)], len(diagnosis.posterior) - len(kept)
    if left > 1:
        together = percent(max(0.0, 1 - sum(p for _, p in kept)))
        note.append(f"The other {left} hypotheses have {together} together.")
    return Table(rows=rows, note=" ".join([*note, _COLUMNS]))


def _listed(diagnosis: Diagnosis) -> list[tuple[str, float]]:
    """Hypotheses of the table with their probabilities, most probable first."""
    ranked = sorted(diagnosis.posterior.items(), key=lambda item: -item[1])
    return [item for k, item in enumerate(ranked) if item[1] >= _LISTED or k == 0][:_RANKED]


def _direction_words(diagnosis: Diagnosis, hypothesis: str) -> str:
    """Direction of a hypothesis's slide; a dash for others."""
    kind, _, where = hypothesis.partition("@")
    if kind != "structural_looseness":
        return "–"
    fault, axis, half = diagnosis.fault, None, None
    if fault.hypothesis == hypothesis:
        axis, half = fault.direction, fault.direction_half_angle_deg
    elif where in diagnosis.directions:
        axis = diagnosis.directions[where].axis
        half = diagnosis.directions[where].half_angle_deg
    if axis is None:
        return "not identified"
    return _vector(axis) + ("" if half is None else f" ±{half:.0f}°")


def _vector(values: Iterable[float]) -> str:
    return f"({', '.join(f'{x:.2f}' for x in values)})".replace("-", "−")


def travel_words(diagnosis: Diagnosis, arm: Arm) -> str:
    """Free travel of the fault with its interval; "not identified" where there is none."""
    fault = diagnosis.fault
    if fault.kind == HEALTHY:
        return "–"
    if fault.gap_m is None:
        return "not identified"
    turns = fault.kind == "backlash" and not slides(arm, str(fault.where))
    scale, unit = (60 * 180 / np.pi, "arc minutes") if turns else (1e3, "mm")
    ends = fault.gap_interval_m
    between = "" if ends is None else f" ({scale * ends[0]:.2g} to {scale * ends[1]:.2g})"
    return f"{scale * fault.gap_m:.2g}{between} {unit}"


def _runs(diagnosis: Diagnosis, hypothesis: str) -> str:
    """Runs that raised the probability of a hypothesis, of those that could be used."""
    before = float(diagnosis.settings.get("healthy_prior", 0.5))
    if hypothesis != HEALTHY:
        before = (1 - before) / max(len(diagnosis.posterior) - 1, 1)
    used = [r.probabilities.get(hypothesis, 0.0) for r in diagnosis.records if r.probabilities]
    risen = sum(after > b for b, after in zip([before, *used[:-1]], used, strict=False))
    return f"{risen} of {len(used)}" if used else "–"


def data_words(diagnosis: Diagnosis) -> str:
    """Records and poses that a diagnosis rests on."""

    def count(number: int, noun: str) -> str:
        return f"one {noun}" if number == 1 else f"{number} {noun}s"

    suspect = [r for r in diagnosis.records if r.condition != HEALTHY]
    poses = {tuple(round(v, 3) for v in r.pose.values()) for r in suspect}
    healthy = len(diagnosis.records) - len(suspect)
    said = begun(f"{count(len(suspect), 'record')} in {count(len(poses), 'pose')}")
    unused = sum(not r.probabilities for r in suspect)
    if unused:
        said += f", {unused} of which could not be used"
    if healthy:
        return f"{said}, beside {count(healthy, 'record')} of the healthy arm."
    return f"{said}. There is no record of the healthy arm: the model stands in its place."


def summary_words(diagnosis: Diagnosis, arm: Arm) -> list[str]:
    """Probability and meaning of the outcome, and reasons why it is open."""
    if diagnosis.verdict != "model_mismatch":
        said = begun(short_name(arm, diagnosis.fault.hypothesis))
        first = f"{said}: {percent(diagnosis.probability)}. {_meaning(diagnosis, arm)}"
        return [first, *_reasons(diagnosis, arm)]
    first = (
        "Model and record differ by more than the model's tolerances and any single fault explain: "
        "no fault is identified."
    )
    if np.isfinite(diagnosis.misfit):
        first += f" The best model leaves {100 * diagnosis.misfit:.0f} % of the record unexplained."
    return [first, *_reasons(diagnosis, arm)]


def _reasons(diagnosis: Diagnosis, arm: Arm) -> list[str]:
    """Reasons why no fault is identified, with the hypotheses in words."""
    if diagnosis.verdict not in ("open", "model_mismatch"):
        return []
    names = {name: short_name(arm, name) for name in diagnosis.posterior}
    return [sentence(with_plain_names(reason, names)) for reason in diagnosis.open_because]


def _meaning(diagnosis: Diagnosis, arm: Arm) -> str:
    fault = diagnosis.fault
    if fault.where is None:
        shown = ""
        if np.isfinite(diagnosis.nothing_opened):
            shown = f" (that nothing opened in any run: {percent(diagnosis.nothing_opened)})"
        return (
            f"All motion is transmitted as in the healthy arm{shown}. A seat that friction or "
            "weight kept shut cannot be told from a healthy one."
        )
    if fault.kind == "backlash":
        return "Its motor and its link are not tightly connected."
    joint = arm.joints[arm.seat_bodies.index(fault.where)]
    return f"It slides where it is fastened to {joint_words(arm, joint)}."


def _commands(diagnosis: Diagnosis, folder: str) -> list[str]:
    """Commands that correct the model and diagnose again, where it is not that of the arm."""
    if diagnosis.verdict != "model_mismatch":
        return []
    ends = ("", "-gap", "-gap/model.xml", "-corrected")
    recording, gap, model, out = (path_word(f"{folder or 'RECORDING'}{end}") for end in ends)
    return [
        f"loose gap {recording} --out {gap}",
        f"loose diagnose {recording} --model {model} --out {out}",
    ]


def diagnosis_steps(diagnosis: Diagnosis, arm: Arm) -> list[str]:
    """Next steps of a diagnosis, in order."""
    if diagnosis.verdict == "model_mismatch":
        return [
            "Correct the model by the same recording (first command below). Record free motions "
            "too, slow and fast, where it finds too little.",
            "Diagnose again with the corrected model (second command).",
        ]
    found, fault = [], diagnosis.fault
    if diagnosis.next is not None:
        names = {name: short_name(arm, name) for name in diagnosis.posterior}
        found.append(_measure(diagnosis.next, arm, names))
    if diagnosis.verdict == "open":
        if diagnosis.next is None:
            found.append(
                "Measure in further poses, each far from those before, or louder: what is at hand "
                "does not decide it."
            )
        return [*found, "Take nothing apart yet: the case is open."]
    if fault.where is None:
        return [
            *found,
            "Nothing needs to be done. Keep this recording: it is the reference of the healthy "
            "arm.",
        ]
    look = (
        f"Look at the drive of {joint_words(arm, fault.where)}: gear, coupling, key, belt."
        if fault.kind == "backlash"
        else f"Look at what fastens {link_words(arm, fault.where)}: bolts, dowels, cracks at the "
        "flange."
    )
    again = (
        "Measure once more in the same poses after the repair: the transmission should be that of "
        "the healthy arm again."
    )
    return [*found, look, again]


def _measure(following: NextMeasurement, arm: Arm, plain: Mapping[str, str]) -> str:
    names = [joint_words(arm, joint) for joint in following.joints]
    shaken = named_list(names) + (" in turn" if len(names) > 1 else "")
    reason = following.reason.strip()
    return (
        f"Measure once more in the pose shown below: shake {shaken} for {following.seconds:g} s, "
        f"hold the others. {sentence(with_plain_names(reason, plain)) if reason else ''}"
    ).rstrip()


def _measurement(diagnosis: Diagnosis, arm: Arm) -> list[str]:
    """Pose and excitation of the next measurement in two lines."""
    following = diagnosis.next
    if following is None or diagnosis.verdict == "model_mismatch":
        return []
    pose = [f"{joint_words(arm, j)} {position_text(arm, j, q)}" for j, q in following.pose.items()]
    shaken = [
        f"{joint_words(arm, joint)} by {torque:.3g} {'N' if slides(arm, joint) else 'N·m'} rms"
        for joint, torque in zip(following.joints, following.torques, strict=True)
    ]
    low, high = following.band_hz
    return [
        f"pose: {', '.join(pose)}",
        f"shake: {', '.join(shaken)}, {low:g} to {high:g} Hz, {following.seconds:g} s",
    ]


def _arm_card(diagnosis: Diagnosis, arm: Arm) -> FigureCard:
    fault = diagnosis.fault
    suspect = [r for r in diagnosis.records if r.condition != HEALTHY]
    last = suspect[-1] if suspect else None
    marked = "Nothing is marked: nothing is suspected."
    if fault.where is not None:
        said = short_name(arm, fault.hypothesis)
        marked = f"Marked: {said} ({percent(diagnosis.probability)})."
    if any(name != f"joint{k}" for k, name in enumerate(arm.joints, 1)):
        names = [f"{k} {name}" for k, name in enumerate(arm.joints, 1)]
        marked += f" Joints from the base: {', '.join(names)}."
    return FigureCard(
        title="The last pose measured" if last else "The arm, all joints at zero",
        image=arm_figure(
            arm, last.pose if last else {}, fault=fault, excited=last.excited if last else None
        ),
        caption=marked,
    )


def _posterior_cards(diagnosis: Diagnosis, arm: Arm) -> list[FigureCard]:
    seen = [(k, r) for k, r in enumerate(diagnosis.records, 1) if r.probabilities]
    if not seen:
        return []
    drawn, dropped = seen[-_BARS:], max(len(seen) - _BARS, 0)
    steps = [dict(r.probabilities) for _, r in drawn]
    names = {h: short_name(arm, h) for h in shown_hypotheses(steps)}
    return [
        FigureCard(
            title="Probability by record",
            image=posterior_figure(steps, [f"record {k}" for k, _ in drawn], names),
            caption="Probability of every explanation after each record and all before it, in per "
            "cent. A record supports an explanation that predicted the measurement. The "
            "records are numbered as in the table at the end."
            + (f" The first {dropped} are not drawn." if dropped else ""),
        )
    ]


def _next_section(diagnosis: Diagnosis, arm: Arm) -> Section:
    following = diagnosis.next
    if following is None:
        return Section()
    units = {joint: "m" if slides(arm, joint) else "rad" for joint in following.pose}
    pose = [
        {
            "Joint": joint_words(arm, joint),
            "Hold at": position_text(arm, joint, value),
            "In the recording": f"{value:.4f} {units[joint]}",
        }
        for joint, value in following.pose.items()
    ]
    numbers = zip(following.joints, following.levels, following.torques, strict=True)
    excitation = [
        {
            "Joint to shake": joint_words(arm, joint),
            "Acceleration, rms": f"{level:.3g} {units[joint]}/s²",
            "Drive, rms": f"{torque:.3g} {'N' if slides(arm, joint) else 'N·m'}",
        }
        for joint, level, torque in numbers
    ]
    many = "s in yellow one after the other" if len(following.joints) > 1 else " in yellow"
    low, high = following.band_hz
    intro = [
        f"Random noise from {low:g} to {high:g} Hz for {following.seconds:g} s, sampled at "
        f"{following.rate_hz:g} Hz, one run for each joint."
    ]
    if following.gain > 0:
        intro.append(
            f"Expected information: {following.gain:.2g} bits about the fault; one bit halves the "
            "possibilities."
        )
    note = (
        "The drive is what the nominal model needs for this acceleration; check it against the "
        "drive's limits before it is played."
    )
    card = FigureCard(
        title="The pose to measure next",
        image=arm_figure(arm, following.pose, fault=diagnosis.fault, excited=following.joints),
        caption=f"Shake the joint{many}, hold the others.",
    )
    return Section(
        heading="The next measurement",
        intro=intro,
        cards=[card],
        beside=True,
        tables=[
            Table(rows=pose, note="Positions from the base, every joint held there."),
            Table(title="Excitation", rows=excitation, note=note),
        ],
    )


def _loops_section(diagnosis: Diagnosis, arm: Arm) -> Section:
    drawn = [(k, r) for k, r in enumerate(diagnosis.records, 1) if r.loops]
    cards = [
        FigureCard(
            title=f"Record {number}: {', '.join(record.excited) or 'nothing'} shaken",
            image=loop_figure(record),
            caption=_loop_words(record, arm),
        )
        for number, record in drawn[-_LOOPS:]
    ]
    dropped = len(drawn) - _LOOPS
    intro = (
        "Correlation of the tool with the excited joint, by direction. The distance of the curve "
        "from the middle is the correlation; on the circle it is 1. Where a link is loose, the "
        "measured curve turns away from that of the healthy arm. The direction in which motion is "
        "lost turns from pose to pose only if a joint between the loose link and the tool was "
        "moved: that is how the link is found."
    )
    if dropped > 0:
        intro += f" The first {dropped} records are not drawn."
    return Section(heading="Correlation by record", intro=[intro], cards=cards)


def _loop_words(record: RecordSeen, arm: Arm) -> str:
    pose = ", ".join(position_text(arm, joint, value) for joint, value in record.pose.items())
    said = f"Pose {pose}. " if pose else ""
    if record.direction_tool is None:
        return f"{said}No direction in which motion is lost stands out."
    within = "" if record.half_angle_deg is None else f", within {record.half_angle_deg:.0f}°"
    return (
        f"{said}By all records together, motion is lost along {_vector(record.direction_tool)} of "
        f"the tool's frame here{within}."
    )


def _records_section(diagnosis: Diagnosis, arm: Arm) -> Section:
    rows, notes = [], ["The pose lists the joints from the base."]
    for number, record in enumerate(diagnosis.records, 1):
        best = max(record.probabilities.items(), key=lambda item: item[1], default=None)
        pose = ", ".join(position_text(arm, j, v) for j, v in record.pose.items())
        rows.append(
            {
                "Record": str(number),
                "File": record.file,
                "Arm": record.condition,
                "Excited joints": ", ".join(record.excited) or "–",
                "Pose": pose or "–",
                "Most probable then": f"{short_name(arm, best[0])}, {percent(best[1])}"
                if best
                else "–",
            }
        )
        notes += [f"Record {number}: {sentence(note)}" for note in record.notes]
    return Section(heading="Records", tables=[Table(rows=rows, note=" ".join(notes))])


def _notes(diagnosis: Diagnosis, arm: Arm) -> list[str]:
    plain = {k: v for k, v in diagnosis.settings.items() if not isinstance(v, dict)}
    settings = ", ".join(f"{name} {value}" for name, value in plain.items())
    by = " ".join(filter(None, ["loose-env", diagnosis.version]))
    hashed = f" (SHA-256 {diagnosis.model_hash})" if diagnosis.model_hash else ""
    measured = f"Measured {diagnosis.date}. " if diagnosis.date else ""
    return [
        f"{measured}Diagnosed by {by}. Model: {diagnosis.model}{hashed}, {arm.n} joints. All "
        "numbers stand in result.json.",
        *([f"Settings: {settings}."] if settings else []),
    ]
