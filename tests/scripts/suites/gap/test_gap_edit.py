"""The edit test: the machine and its corrected model, both without an effect."""

from __future__ import annotations

from scripts.suites.gap.cases.draw import draw_case
from scripts.suites.gap.edits import EditRow, edit_rows, table

NUMBER = 1264


def test_a_corrected_model_predicts_the_machine_without_the_effect() -> None:
    (effect,) = draw_case(NUMBER).arm.effects
    (row,) = edit_rows(NUMBER, kinds=(effect.kind, "rotor_inertia"))
    assert row.effect == f"{effect.kind} at {effect.place.name}" and row.left == 0
    assert row.edited < 1.2 < 2 * row.edited < row.unedited


def test_nothing_is_edited_where_nothing_was_named_rightly() -> None:
    assert edit_rows(NUMBER, kinds=("rotor_inertia",)) == []


def test_the_table_has_a_line_for_each_effect() -> None:
    row = EditRow(
        number=3, effect="payload at tool", left=1, nominal=4.0, unedited=3.0, edited=1.01
    )
    assert table([row]).splitlines()[-1] == "| 3 | payload at tool | 1 | 4.00 | 3.00 | 1.01 |"
