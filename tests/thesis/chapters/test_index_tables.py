from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest

from loose_env.thesis.ch4_diagnosis.comparative_index import (
    IndexRow,
    directions,
    error_summary,
    index_rows,
)
from loose_env.thesis.printed import printed

SOURCE = Path(__file__).resolve().parents[4] / "shared" / "thesis"
CONDITIONS = {"looseness": "6.5", "low_preload": "6.6", "backlash": "6.7"}

source = pytest.mark.skipif(
    not SOURCE.is_dir(), reason="the tables of the source do not lie beside the repository"
)


def read(name: str) -> list[dict[str, str]]:
    with (SOURCE / f"{name}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def at(condition: str, theta2: int) -> IndexRow:
    return next(row for row in index_rows(condition) if row.theta2 == theta2)


@source
def test_maximum_correlations_are_those_of_the_source() -> None:
    figures = printed("tables")
    rows = read("table_6_4_max_correlation")
    assert [int(row["theta2_deg"]) for row in rows] == figures["theta2_deg"]
    for name in ("C_n", "C_f", "C_b"):
        assert [float(row[name]) for row in rows] == figures["table_6_4"][name.lower()]


@source
def test_index_tables_are_those_of_the_source() -> None:
    figures = printed("tables")
    rows = read("tables_6_5_to_6_7_comparative_index")
    columns = {"one_minus_C_star": "one_minus_c", "delta_phi_deg": "turn_deg", "mag_D": "mag_d"}
    for condition, number in CONDITIONS.items():
        own = [row for row in rows if row["table"] == number and row["condition"] == condition]
        table = figures[f"table_{number.replace('.', '_')}_{condition}"]
        assert [int(row["theta2_deg"]) for row in own] == figures["theta2_deg"]
        for column, key in columns.items():
            assert [float(row[column]) for row in own] == table[key]
    assert len(rows) == 15


@source
def test_histogram_ranges_are_those_of_the_source() -> None:
    figures = printed("tables")
    rows = read("tables_6_1_6_2_histogram_ranges_g")
    found: dict[str, list[list[float]]] = {}
    for row in rows:
        found.setdefault(row["condition"], []).append([float(row["min_g"]), float(row["max_g"])])
    first, second = figures["table_6_1_histogram_range_g"], figures["table_6_2_histogram_range_g"]
    assert found == first | {"backlash": second["backlash"]}
    assert first["high_preload"] == second["high_preload"]


@source
def test_pose_cases_are_those_of_the_source() -> None:
    figures = printed("tables")
    rows = read("vera_cases")
    assert len(rows) == 10
    names = {
        "theta2_deg": "theta2_deg",
        "excitation_dir_deg": "excitation_deg",
        "p1_line_dir_deg": "p1_line_deg",
        "ellipsoid_major_dir_deg": "ellipsoid_major_axis_deg",
        "phi_n_high_preload_deg": "lowest_high_preload_deg",
        "phi_p_low_preload_deg": "lowest_low_preload_deg",
        "direction_error_deg": "error_deg",
    }
    for fault in ("looseness", "backlash"):
        own = [row for row in rows if row["fault"] == fault]
        for row, case in zip(own, figures[f"{fault}_cases"], strict=True):
            said = {key: case.get(key) for key in names.values()}
            if case.get("excitation_deg", 0) is None:  # follows from the printed perpendicular
                said["excitation_deg"] = (case["perpendicular_deg"] - 90) % 360
            said |= {"own": case[f"{fault}_deg"], "found": case[f"lowest_{fault}_deg"]}
            columns = names | {"actual_fault_dir_deg": "own", "phi_f_fault_deg": "found"}
            for column, key in columns.items():
                assert said[key] == (float(row[column]) if row[column] else None), (row, column)


def test_the_excitation_and_its_perpendicular_are_perpendicular() -> None:
    for case in printed("tables")["looseness_cases"]:
        if case["excitation_deg"] is not None:
            turn = case["excitation_deg"] - case["perpendicular_deg"]
            assert turn % 180 == 90


def test_printed_errors_average_as_printed_with_their_signs() -> None:
    table = printed("tables")["table_6_3"]
    for fault, rms in (("looseness", 20.494), ("backlash", 15.969)):
        summary = error_summary(table[f"{fault}_error_deg"], [0.0] * 5)
        assert summary.mean == table[f"{fault}_average_deg"]
        assert summary.rms == pytest.approx(rms, abs=1e-3)


def test_errors_follow_from_the_directions_in_the_text() -> None:
    looseness = error_summary(*directions("looseness"))
    assert looseness.mean == pytest.approx(11.0)  # 35° in place of the printed 20°
    assert looseness.rms == pytest.approx(math.sqrt(585.0))
    assert looseness.largest == 35.0
    backlash = error_summary(*directions("backlash"))
    assert backlash.mean == pytest.approx(9.0)
    assert backlash.largest == 20.0


def test_errors_are_those_of_axes() -> None:
    assert error_summary([350.0], [175.0]).mean == pytest.approx(-5.0)
    assert error_summary([1.0, 179.0], [180.0, 0.0]) == (0.0, 1.0, 1.0)


@pytest.mark.parametrize("condition", CONDITIONS)
def test_the_printed_index_follows_from_its_own_columns(condition: str) -> None:
    for row in index_rows(condition):
        product = row.change_printed * abs(math.sin(math.radians(row.turn_printed)))
        assert row.mag_d_columns == pytest.approx(product, abs=1e-12)
        assert abs(row.mag_d_columns - row.mag_d_printed) < 0.0051


@pytest.mark.parametrize(
    ("condition", "theta2", "change", "turn", "mag_d"),
    [
        # By hand from table 6.4 and the text.
        ("looseness", 122, 0.375, 80.0, 0.375 * math.sin(math.radians(80))),
        ("looseness", 98, 0.5, 85.0, 0.5 * math.sin(math.radians(85))),
        ("looseness", 56, 0.5, -70.0, 0.5 * math.sin(math.radians(70))),
        ("low_preload", 98, 0.13, 0.0, 0.0),
        ("low_preload", 56, 0.0, -10.0, 0.0),
        ("backlash", 98, 0.375, -40.0, 0.375 * math.sin(math.radians(40))),
        ("backlash", 28, 11 / 15, 70.0, 11 / 15 * math.sin(math.radians(70))),
        ("backlash", 302, 0.1, 10.0, 0.1 * math.sin(math.radians(10))),
    ],
)
def test_the_index_follows_from_table_and_text(
    condition: str, theta2: int, change: float, turn: float, mag_d: float
) -> None:
    row = at(condition, theta2)
    assert row.change == pytest.approx(change)
    assert row.turn == pytest.approx(turn)
    assert row.mag_d == pytest.approx(mag_d, abs=1e-9)


def test_the_slips_of_the_source_are_found() -> None:
    slips = {
        (condition, row.theta2): (bool(row.change_off), row.turn_off > 5.0)
        for condition in CONDITIONS
        for row in index_rows(condition)
        if row.slip
    }
    assert slips == {
        ("looseness", 56): (True, False),
        ("low_preload", 98): (False, True),
        ("low_preload", 302): (False, True),
        ("backlash", 98): (False, True),
        ("backlash", 56): (False, True),
        ("backlash", 28): (False, True),
        ("backlash", 302): (True, True),
    }
    assert at("low_preload", 56).remark == "angle one step off"
    assert at("looseness", 122).remark == "agrees"


def test_looseness_and_low_preload_stay_apart() -> None:
    least = min(row.mag_d for row in index_rows("looseness"))
    most = max(row.mag_d for row in index_rows("low_preload"))
    assert least == pytest.approx(math.sin(math.radians(15)) / 3)
    assert most == pytest.approx(0.08 * math.sin(math.radians(10)))


def test_the_section_lists_every_slip() -> None:
    pytest.importorskip("matplotlib")
    from loose_env.thesis.ch4_diagnosis.index_tables import section

    found = section(0)
    slips = found.tables[-1].rows
    assert ("Table 6.3, 302°", "error, looseness", "20°", "35°") in slips
    assert ("Table 6.3", "average, looseness", "8°", "11°") in slips
    assert ("Table 6.5, 56°", "|1\u00a0−\u00a0C*|", "0.80", "0.50") in slips
    assert ("Table 6.7, 98°", "φn\u00a0−\u00a0φ", "5°", "-40°") in slips
    assert len(slips) == 10
    assert any(words.startswith("10 printed figures") for words in found.words)
    assert any("survives the corrections" in words for words in found.words)
    assert not any("nan" in cell for table in found.tables for row in table.rows for cell in row)
