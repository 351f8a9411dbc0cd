"""Grade of a `loose gap` result against the truth: effects, parameters, intervals."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize

from loose_env.typing import Array
from scripts.suites.gap.cases import HELD_OUT, SEED, VISIBLE, Case, Visibility, draw_case
from scripts.suites.gap.effects import KINDS, RANDOM, Effect, Kind, Parameters, Place
from scripts.suites.gap.machine import Motion

PARAMETERS: Mapping[str, tuple[str, ...]] = {
    "viscous_friction": ("damping",),
    "coulomb_friction": ("torque",),
    "stribeck_friction": ("torque",),
    "quadratic_drag": ("drag",),
    "joint_compliance": ("stiffness",),
    "backlash": ("gap",),
    "structural_looseness": ("gap",),
    "link_flexibility": ("stiffness",),
    "link_mass": ("mass",),
    "link_com": ("x", "y", "z"),
    "payload": ("mass",),
    "rotor_inertia": ("inertia",),
    "actuator_gain": ("gain",),
    "actuator_lag": ("time",),
    "command_delay": ("delay",),
    "encoder_offset": ("offset",),
    "sensor_misalignment": ("x", "y", "z"),
    "sensor_gain": ("gain",),
    "sensor_bias": ("bias", "x", "y", "z"),
    "sensor_delay": ("delay",),
    "base_tilt": ("x", "y"),
    "torque_ripple": ("amplitude",),
    "joint_spring": ("stiffness",),
    "load_friction": ("share",),
    "asymmetric_friction": ("forward", "backward"),
    "torque_limit": ("limit",),
    "voltage_limit": ("stall_torque",),
    "dead_zone": ("width",),
    "gravity_compensation": ("share",),
    "torque_constant": ("factor",),
    "base_compliance": ("stiffness",),
    "gear_eccentricity": ("sine", "cosine"),
    "sensor_quantisation": ("step",),
}
"""Parameters by which an effect is judged; those of a kind make one vector."""
SAID: Mapping[str, Mapping[str, str]] = {
    "actuator_lag": {"time": "time_constant"},
    "sensor_misalignment": {axis: f"turn_{axis}" for axis in "xyz"},
    "base_tilt": {axis: f"tilt_{axis}" for axis in "xyz"},
    "sensor_bias": {axis: f"bias_{axis}" for axis in "xyz"},
}
"""Name of a parameter in a result, where it is not that of the truth."""
NEUTRAL = {"gain": 1.0, "factor": 1.0}
"""Values that change nothing; an error is judged against the distance from them."""
OTHERS: Mapping[str, Mapping[str, Callable[[Mapping[str, Any]], float]]] = {
    "stribeck_friction": {
        "static_ratio": lambda p: p["static_torque"] / p["torque"],
        "speed": lambda p: p["speed"],
    },
    "link_flexibility": {"position": lambda p: p["position"]},
    "structural_looseness": {"friction": lambda p: p["friction"]},
    "joint_spring": {"reference": lambda p: p["reference"]},
    "payload": {axis: (lambda p, axis=axis: p[axis]) for axis in "xyz"},  # type: ignore[misc]
    "voltage_limit": {"no_load_speed": lambda p: p["no_load_speed"]},
    "torque_ripple": {"periods": lambda p: p["order"], "phase": lambda p: p["phase"]},
}
"""Further parameters of a result that mean the same in the truth: what they are there. Damping and
stiffness of stops are laws of another form there, and have no counterpart."""


def _in_words_of_truth(effect: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters and intervals of a named effect under the names that the truth has."""
    words = {said: true for true, said in SAID.get(str(effect["kind"]), {}).items()}
    found = dict(effect)
    for part in ("parameters", "interval_95"):
        found[part] = {words.get(k, k): v for k, v in (effect.get(part) or {}).items()}
    return found


def _values(effect: Mapping[str, Any], names: Sequence[str]) -> np.ndarray:
    given = effect.get("parameters", {})
    return np.array([float(given.get(name, 0.0)) - NEUTRAL.get(name, 0.0) for name in names])


def _names(kind: str, truth: Mapping[str, Any], effect: Mapping[str, Any]) -> list[str]:
    given = effect.get("parameters", {})
    names = [name for name in PARAMETERS.get(kind, ()) if name in truth["parameters"]]
    return names if any(name in given for name in names) else []


def parameter_error(truth: Mapping[str, Any], effect: Mapping[str, Any]) -> float:
    """Relative error of the parameters of a named effect, as one vector; NaN without any."""
    said = _in_words_of_truth(effect)
    names = _names(str(truth["kind"]), truth, said)
    if not names:
        return float("nan")
    want, have = _values(truth, names), _values(said, names)
    return float(np.linalg.norm(have - want) / np.linalg.norm(want))


@dataclasses.dataclass(frozen=True, kw_only=True)
class JudgedInterval:
    """The 95 % interval of a parameter, beside its true value."""

    name: str
    main: bool
    """Whether it is one of `PARAMETERS`; else a further one of `OTHERS`."""
    value: float
    interval: tuple[float, float]
    truth: float

    @property
    def held(self) -> bool:
        """Whether the interval holds the truth."""
        low, high = self.interval
        return low <= self.truth <= high


def judged_intervals(truth: Mapping[str, Any], effect: Mapping[str, Any]) -> list[JudgedInterval]:
    """Intervals of a named effect whose parameters mean the same in the truth."""
    kind, said = str(truth["kind"]), _in_words_of_truth(effect)
    wanted = [(name, True, truth["parameters"][name]) for name in _names(kind, truth, said)]
    for name, of in OTHERS.get(kind, {}).items():
        try:
            wanted.append((name, False, float(of(truth["parameters"]))))
        except KeyError:
            continue
    found = []
    for name, main, true in wanted:
        if name not in said["interval_95"]:
            continue
        low, high = (float(end) for end in said["interval_95"][name])
        value = float(said["parameters"].get(name, 0.5 * (low + high)))
        if name == "phase":  # the same after every turn
            true += 2 * np.pi * round((value - true) / (2 * np.pi))
        found.append(
            JudgedInterval(
                name=name, main=main, value=value, interval=(low, high), truth=float(true)
            )
        )
    return found


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
    """Mark a result."""
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
    """Marks of a case for which there is no result: nothing is right."""
    return grade({"format": "loose-gap/1", "verdict": FAILED}, truth)


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def matched(
    true: Sequence[Named],
    said: Sequence[Named],
    separable: Separable,
    *,
    one_by_one: bool = False,
) -> dict[int, int]:
    """Position of the named effect for every true one that was found."""
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


SCAN = 7
"""Sizes that are tried before the best one is refined."""
STEPS = 60
"""Evaluations of the refinement for every free number."""


class Comparison:
    """One case's effect against others."""

    def __init__(self, case: Case) -> None:
        self.case = case
        runs = self._two_runs()
        self._views = [
            Visibility(case.arm, motion, case.noise, case.form, seed=i)
            for i, motion in enumerate(runs)
        ]
        self._truth = [view.difference(case.arm.effects) for view in self._views]

    def _two_runs(self) -> tuple[Motion, Motion]:
        # a shaken arm's held-out run shakes the same joint in another pose
        motions = self.case.motions
        if self.case.form == RANDOM:
            return motions[-1 - min(2, len(motions) - 1)], motions[HELD_OUT]
        return motions[0], motions[HELD_OUT]

    def separable(self, effect: int, named: Named) -> bool:
        """Whether held-out data tell an effect of the case from another kind and place."""
        return self.score(effect, named) >= VISIBLE

    def score(self, effect: int, named: Named) -> float:
        """Held-out excess of the best other effect in its own standard deviations."""
        kind = KINDS.get(named[0])
        places = [] if kind is None else kind.places(self.case.arm.figures)
        place = next((p for p in places if p.name == named[1]), None)
        if kind is None or place is None:
            return float("inf")
        others = tuple(e for i, e in enumerate(self.case.arm.effects) if i != effect)
        best = min(
            (self._fit(kind, place, drawn, others) for drawn in self._shapes(kind, place)),
            key=lambda found: found[0],
        )
        return self._held_out((*others, best[1]))

    def _shapes(self, kind: Kind, place: Place) -> list[Parameters]:
        """Starting shapes: both signs, and all directions of a vector."""
        rng = np.random.default_rng(2)
        drawn = kind.draw(rng, self.case.arm.figures, place)
        if "sign" in drawn:
            return [{**drawn, "sign": sign} for sign in (-1.0, 1.0)]
        if "direction" in drawn:
            return [
                {**drawn, "direction": (sign * axis).tolist()}
                for axis in np.eye(3)
                for sign in (-1.0, 1.0)
            ]
        return [drawn]

    def _fit(
        self, kind: Kind, place: Place, drawn: Parameters, others: tuple[Effect, ...]
    ) -> tuple[float, Effect]:
        figures = self.case.arm.figures
        low, high = np.log(kind.bounds(figures, place))
        free = [name for name in ("reference", "damping_ratio") if name in drawn]
        turns = "direction" in drawn

        def effect_at(x: Array) -> Effect:
            shape = dict(drawn)
            size = float(np.exp(np.clip(x[0], low, high)))
            for name, value in zip(free, x[1:], strict=False):
                shape[name] = float(value) if name == "reference" else float(np.exp(value))
            if turns:
                direction = x[-3:] / max(float(np.linalg.norm(x[-3:])), 1e-9)
                shape["direction"] = direction.tolist()
            return Effect(
                kind=kind.name, place=place, parameters=kind.size(size, shape, figures, place)
            )

        def loss(x: Array) -> float:
            effects = (*others, effect_at(x))
            difference = self._views[0].difference(effects) - self._truth[0]
            value = self._views[0].excess(difference)
            return float(np.log(max(value, 1e-6))) if np.isfinite(value) else 1e3

        rest = [drawn[name] if name == "reference" else np.log(drawn[name]) for name in free]
        rest += list(drawn["direction"]) if turns else []
        starts = [np.array([size, *rest]) for size in np.linspace(low, high, SCAN + 2)[1:-1]]
        start = min(starts, key=loss)
        found = minimize(
            loss, start, method="Nelder-Mead",
            options={"maxfev": STEPS * len(start), "xatol": 1e-3, "fatol": 1e-3},
        )  # fmt: skip
        return float(found.fun), effect_at(found.x)

    def _held_out(self, effects: tuple[Effect, ...]) -> float:
        """Excess on the second run with the nuisance parameters of the first."""
        fit, judge = self._views
        difference = fit.difference(effects) - self._truth[0]
        nuisance = fit.explained(difference)
        rest = judge.difference(effects) - self._truth[1] + judge.columns @ nuisance
        return judge.score(float(rest @ rest))


def separable_by_data(number: int, *, seed: int = SEED) -> Separable:
    """An answer for `grade.grade`, worked out only if it is asked."""
    known: list[Comparison] = []

    def separable(effect: int, named: Named) -> bool:
        if not known:
            known.append(Comparison(draw_case(number, seed=seed)))
        return known[0].separable(effect, named)

    return separable
