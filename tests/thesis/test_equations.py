"""Every function that a section names for an equation exists, cites it, and obeys it."""

from __future__ import annotations

import inspect
import re
from importlib import import_module
from importlib.util import find_spec

import numpy as np
import pytest

from loose_env.arms import planar
from loose_env.errors import UnknownName
from loose_env.kinematics import Chain, geometric_jacobian
from loose_env.statistics import comparative_index, correlation_loop
from loose_env.thesis.methods.looseness.looseness_joint import displaced, tool_velocity
from loose_env.thesis.methods.motion.loose_planar_arm import LoosePlanarArm, tool_position
from loose_env.thesis.methods.motion.seat_motion import SeatMotion, draw_seat_velocity
from loose_env.thesis.shared.sections import SECTIONS, choose, first_line, load


def function(path: str) -> object:
    """The function or class at a dotted path; a method stands behind its class."""
    parts = path.split(".")
    for k in range(len(parts) - 1, 0, -1):
        name = ".".join(parts[:k])
        try:
            known = find_spec(name) is not None
        except ModuleNotFoundError:  # a parent is no package
            known = False
        if known:
            found: object = import_module(name)
            for part in parts[k:]:
                found = getattr(found, part)
            return found
    raise AssertionError(f"no module in {path}")


@pytest.mark.parametrize("key", list(SECTIONS))
def test_every_section_can_be_run_and_says_what_it_does(key: str) -> None:
    module = load(key)
    assert callable(module.section)
    assert first_line(key)


@pytest.mark.parametrize("key", list(SECTIONS))
def test_the_function_of_every_equation_exists(key: str) -> None:
    for number, path in load(key).EQUATIONS.items():
        assert number.strip("()") == number, "a number stands without brackets"
        assert path.startswith("loose_env."), path
        assert callable(function(path)), f"({number}): {path} is no function"


def cited(source: str) -> set[str]:
    """Numbers of equations that a source text cites, ranges such as 3.15-3.17 spelt out."""
    numbers = set()
    text = " ".join(source.split())
    for chapter, first, other, last in re.findall(
        r"\b(\d)\.(\d+)\)?(?:(?:-| to )\(?(\d)\.(\d+))?", text
    ):
        numbers |= {f"{chapter}.{k}" for k in range(int(first), int(last or first) + 1)}
        assert other in ("", chapter), (
            f"a range leaves its chapter: {chapter}.{first}-{other}.{last}"
        )
    return numbers


def test_citations_are_read_with_their_ranges() -> None:
    assert cited("(3.9, 3.15-3.17, 4.1); (6.15 to\n    6.17)") == {
        *("3.9", "3.15", "3.16", "3.17", "4.1", "6.15", "6.16", "6.17"),
    }


@pytest.mark.parametrize("key", list(SECTIONS))
def test_the_function_of_every_equation_cites_it(key: str) -> None:
    # The list and the code must agree: an entry moved by hand to another function fails here.
    for number, path in load(key).EQUATIONS.items():
        assert number in cited(inspect.getdoc(function(path)) or ""), f"({number}): {path}"


def test_only_the_part_beyond_a_seat_moves_with_it() -> None:
    chain = Chain.of(planar(3), [0.3, 0.8, -0.5])
    moved = displaced(chain, 2, [0, 1, 0], 0.01)
    np.testing.assert_array_equal(moved.anchors[:2], chain.anchors[:2])  # (3.33)
    assert np.linalg.norm(moved.anchors[2] - chain.anchors[2]) == pytest.approx(0.01)


def test_velocities_add_up_and_columns_are_cross_products() -> None:
    chain = Chain.of(planar(3), [0.3, 0.8, -0.5])
    jacobian, rates = geometric_jacobian(chain), np.array([0.4, -1.0, 0.7])
    parts = [
        rate * np.cross(axis, chain.tool - anchor)  # (3.54)
        for rate, axis, anchor in zip(rates, chain.axes, chain.anchors, strict=True)
    ]
    np.testing.assert_allclose(tool_velocity(jacobian, rates)[:3], np.sum(parts, axis=0))  # (3.53)


def test_a_seat_at_a_stop_moves_away_from_it() -> None:
    seat = SeatMotion()
    rng = np.random.default_rng(0)
    at_distal = draw_seat_velocity(seat, np.full(500, seat.gap / 2), rng)
    at_proximal = draw_seat_velocity(seat, np.full(500, -seat.gap / 2), rng)
    assert at_distal.max() <= 0.0 < -at_distal.min()  # (3.35)
    assert at_proximal.min() >= 0.0 < at_proximal.max()  # (3.36)


def test_the_tight_arm_reaches_where_two_links_do() -> None:
    one, two = 0.4, 0.7
    arm = LoosePlanarArm(length1=0.3, length2=0.5)
    wanted = [
        0.3 * np.cos(one) + 0.5 * np.cos(one + two),
        0.3 * np.sin(one) + 0.5 * np.sin(one + two),
    ]
    np.testing.assert_allclose(tool_position(arm, [one, two], 0.0), wanted)  # (6.1)


def test_the_loop_changes_sign_half_a_turn_on() -> None:
    rng = np.random.default_rng(1)
    x, a = rng.standard_normal(200), rng.standard_normal((2, 200))
    angles = np.radians([10.0, 70.0, 155.0])
    np.testing.assert_allclose(
        correlation_loop(x, a + x, angles), -correlation_loop(x, a + x, angles + np.pi)
    )  # (4.15)


def test_the_index_is_the_size_of_a_cross_product() -> None:
    c_n, phi_n, c_f, phi_f = 0.6, 1.9, 0.45, 0.4
    nominal = np.array([np.cos(phi_n), np.sin(phi_n), 0.0])  # of length one once normalised
    fault = c_f / c_n * np.array([np.cos(phi_f), np.sin(phi_f), 0.0])
    cross = np.linalg.norm(np.cross(fault, nominal))  # (6.15, 6.16)
    assert comparative_index(c_n, phi_n, c_f, phi_f).mag_e == pytest.approx(cross)


def test_a_wrong_path_is_noticed() -> None:
    assert callable(function("loose_env.statistics.correlation.comparative_index"))
    assert callable(function("loose_env.errors.LooseEnvError.with_traceback"))
    for path in (
        "loose_env.statistics.correlation.none_such",
        "loose_env.none_such.f",
    ):
        with pytest.raises(AttributeError):
            function(path)


def test_sections_are_chosen_in_the_order_of_the_page() -> None:
    assert choose() == list(SECTIONS)
    assert choose(["link_finding", "sizing", "sizing"]) == ["sizing", "link_finding"]
    with pytest.raises(UnknownName, match=r"'nothing'.*index_tables"):
        choose(["nothing"])


def test_a_section_without_a_module_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SECTIONS, "sizing", "loose_env.thesis.none_such")
    with pytest.raises(UnknownName, match="none_such"):
        load("sizing")
    assert first_line("sizing") == "(no module)"
