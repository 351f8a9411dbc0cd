"""Marks for a result: pure functions of result.json, truth.json and what cannot be told apart."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from scripts.suites.gap.grading.parameters import (
    judged_intervals,
    parameter_error,
)

Named = tuple[str, str]
"""Kind and place."""
Separable = Callable[[int, Named], bool]
"""Whether the effect of a case (its position in the truth) can be told from another one."""

NO_GAP, UNEXPLAINED, NAMED = "no_gap", "unexplained", "named"
FAILED = "failed"
"""Verdict of a case for which the tool gave no result."""

LISTED: frozenset[frozenset[str]] = frozenset(
    frozenset(pair)
    for pair in (
        ("command_delay", "joint_compliance"),
        ("payload", "link_mass"),
        ("payload", "actuator_gain"),
        ("coulomb_friction", "backlash"),
        ("sensor_bias", "base_tilt"),
        ("link_mass", "joint_spring"),
        ("link_com", "joint_spring"),
        ("payload", "joint_spring"),
        ("base_tilt", "joint_spring"),
        ("viscous_friction", "actuator_gain"),
        ("base_tilt", "encoder_offset"),
        ("sensor_delay", "command_delay"),
        ("joint_compliance", "link_flexibility"),
        ("actuator_lag", "command_delay"),
        ("torque_constant", "actuator_gain"),
        ("gravity_compensation", "link_mass"),
        ("gravity_compensation", "link_com"),
        ("gravity_compensation", "payload"),
        ("gravity_compensation", "joint_spring"),
        ("gravity_compensation", "base_tilt"),
        ("asymmetric_friction", "coulomb_friction"),
        ("asymmetric_friction", "joint_spring"),
        ("load_friction", "coulomb_friction"),
        ("load_friction", "actuator_gain"),
        ("torque_limit", "voltage_limit"),
        ("gear_eccentricity", "encoder_offset"),
        ("gear_eccentricity", "joint_spring"),
        ("base_compliance", "joint_compliance"),
    )
)
"""Pairs of kinds that data may not separate; for these the alternative is fitted and judged."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Grade:
    """Marks of one case."""

    case: str
    role: str
    """`none`, `single`, `pair` or `outside`."""
    form: str
    truth: tuple[Named, ...]
    """True kinds and places."""
    said: tuple[Named, ...]
    """Named kinds and places."""
    verdict: str
    right: bool
    """Kinds and places all right, none too many; or the verdict where nothing is to be named."""
    found: int
    """How many of the true effects were named."""
    by_alternative: bool
    """Whether an effect counted that cannot be told from the true one."""
    ratio: float
    """Smallest size of the effects over the size that is just visible; NaN without effects."""
    parameter_error: tuple[float, ...]
    """Relative error of the parameters of every effect named by its own name."""
    covered: tuple[bool, ...]
    """Whether each 95 % interval given of these parameters holds the truth."""
    covered_others: tuple[bool, ...]
    """The same of further parameters that mean the same in truth and result."""
    gap_before: float
    """Held-out gap of the nominal model, in noise standard deviations."""
    gap_after: float
    """Held-out gap of the corrected model, in noise standard deviations."""
    seconds: float
    """Time the tool took, NaN if not given [s]."""
    exported: float
    """Held-out gap of the written model in plain MuJoCo, over that of the fit; NaN if unchecked."""


def grade(
    result: Mapping[str, Any],
    truth: Mapping[str, Any],
    *,
    separable: Separable = lambda effect, named: True,
    seconds: float = float("nan"),
    exported: float = float("nan"),
) -> Grade:
    """Mark a result.

    Parameters
    ----------
    result : mapping
        A result of format `loose-gap/1`.
    truth : mapping
        A truth of format `gap-truth/1`.
    separable : callable
        Asked only about pairs of `LISTED`: whether the data tell effect i of the truth from a
        named kind and place. By default all do.
    seconds : float
        Time the tool took [s].
    exported : float
        Held-out gap of the written model, over that of the fit.

    Returns
    -------
    Grade

    Raises
    ------
    ValueError
        If the format of either is another one.

    Examples
    --------
    >>> truth = {
    ...     "format": "gap-truth/1",
    ...     "case": "case-0001",
    ...     "role": "single",
    ...     "form": "forward",
    ...     "effects": [
    ...         {
    ...             "kind": "payload",
    ...             "where": "tool",
    ...             "parameters": {"mass": 1.0},
    ...             "size": {"ratio": 3.0},
    ...         }
    ...     ],
    ... }
    >>> result = {
    ...     "format": "loose-gap/1",
    ...     "verdict": "named",
    ...     "gap": {"before": 4, "after": 1},
    ...     "effects": [
    ...         {
    ...             "kind": "payload",
    ...             "where": "tool",
    ...             "parameters": {"mass": 1.1},
    ...             "interval_95": {"mass": [0.9, 1.2]},
    ...         }
    ...     ],
    ... }
    >>> marks = grade(result, truth)
    >>> marks.right, round(marks.parameter_error[0], 3), marks.covered
    (True, 0.1, (True,))
    """
    for name, given, wanted in (
        ("result", result.get("format"), "loose-gap/1"),
        ("truth", truth.get("format"), "gap-truth/1"),
    ):
        if given != wanted:
            raise ValueError(f"the {name} has format {given!r}; {wanted!r} is graded")
    verdict = str(result["verdict"])
    effects = list(result.get("effects", ())) if verdict == NAMED else []
    true = [(str(e["kind"]), str(e["where"])) for e in truth["effects"]]
    said = [(str(e["kind"]), str(e["where"])) for e in effects]
    role = str(truth["role"])
    match = matched(true, said, separable, one_by_one=role == "machine")
    if role == "none":
        right = verdict == NO_GAP
    elif role == "outside":
        right = verdict == UNEXPLAINED
    else:
        right = len(match) == len(true) == len(said)
    errors: list[float] = []
    covered: list[bool] = []
    others: list[bool] = []
    for i, j in match.items() if role != "outside" else ():
        if true[i] == said[j]:
            errors.append(parameter_error(truth["effects"][i], effects[j]))
            for judged in judged_intervals(truth["effects"][i], effects[j]):
                (covered if judged.main else others).append(judged.held)
    gap = result.get("gap") or {}
    return Grade(
        case=str(truth["case"]),
        role=role,
        form=str(truth["form"]),
        truth=tuple(true),
        said=tuple(said),
        verdict=verdict,
        right=right,
        found=len(match),
        by_alternative=any(true[i] != said[j] for i, j in match.items()),
        ratio=min((e["size"]["ratio"] for e in truth["effects"]), default=float("nan")),
        parameter_error=tuple(error for error in errors if np.isfinite(error)),
        covered=tuple(covered),
        covered_others=tuple(others),
        gap_before=_number(gap.get("before")),
        gap_after=_number(gap.get("after")),
        seconds=seconds,
        exported=exported,
    )


def failed(truth: Mapping[str, Any]) -> Grade:
    """Marks of a case for which there is no result: nothing is right.

    Parameters
    ----------
    truth : mapping
        Case, role, form and effects, as in a truth of format `gap-truth/1`.

    Examples
    --------
    >>> failed({"case": "case-0001", "role": "none", "form": "free", "effects": []}).right
    False
    """
    nan = float("nan")
    return Grade(
        case=str(truth["case"]),
        role=str(truth["role"]),
        form=str(truth["form"]),
        truth=tuple((str(e["kind"]), str(e["where"])) for e in truth["effects"]),
        said=(),
        verdict=FAILED,
        right=False,
        found=0,
        by_alternative=False,
        ratio=min((e["size"]["ratio"] for e in truth["effects"]), default=nan),
        parameter_error=(),
        covered=(),
        covered_others=(),
        gap_before=nan,
        gap_after=nan,
        seconds=nan,
        exported=nan,
    )


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def matched(
    true: Sequence[Named],
    said: Sequence[Named],
    separable: Separable,
    *,
    one_by_one: bool = False,
) -> dict[int, int]:
    """Position of the named effect for every true one that was found.

    Parameters
    ----------
    true, said : sequence of (str, str)
        True and named kinds and places.
    separable : callable
        Asked about pairs of `LISTED` where as many effects are named as there are.
    one_by_one : bool
        Whether it is asked whatever the number: of a whole machine every effect counts by itself.

    Examples
    --------
    >>> matched([("payload", "tool")], [("backlash", "joint1"), ("payload", "tool")], bool)
    {0: 1}
    """
    match = {i: said.index(effect) for i, effect in enumerate(true) if effect in said}
    # asking is costly: only where their number is right can an alternative make a list right
    if (len(said) != len(true) and not one_by_one) or len(match) == len(true):
        return match
    left = [j for j in range(len(said)) if j not in match.values()]
    for i, effect in enumerate(true):
        if i in match:
            continue
        for j in left:
            if frozenset((effect[0], said[j][0])) in LISTED and not separable(i, said[j]):
                match[i] = j
                left.remove(j)
                break
    return match
