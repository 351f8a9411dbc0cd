"""The sections on modelling and on identification joint by joint."""

import pytest

from loose_env.thesis.ch3_modelling import identification, modelling
from loose_env.thesis.ch3_modelling import matrices as looseness_matrices
from loose_env.thesis.ch3_modelling.alternatives import finding, step_words
from loose_env.thesis.methods.looseness.modelling_alternatives import Disagreement
from loose_env.thesis.printed import printed
from loose_env.thesis.shared.sections import Section

pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def found() -> Section:
    return identification.section(3)


def test_the_equations_of_both_sections_are_listed(found):
    assert {"3.49", "3.60", "3.67", "3.69"} <= set(found.equations)
    # No function writes these out, so none is named for them.
    assert not {"3.14", "3.40", "3.46", "3.62"} & {*found.equations, *modelling.EQUATIONS}
    assert {"3.10", "3.17", "3.25", "3.26", "3.29", "3.33", "3.34"} <= set(modelling.EQUATIONS)


def test_the_docked_arm_keeps_the_motions_of_the_null_space(found):
    counts = {(row[0], row[1]): (row[2], row[3]) for row in found.tables[1].rows}
    for expected, seen in counts.values():
        assert expected == seen
    assert counts["3, clamp", "healthy"] == ("0", "0")
    assert counts["4, clamp", "slide at link 2"] == ("2", "2")


def test_the_docked_arm_names_its_loose_link(found):
    for k, row in enumerate(found.tables[2].rows, start=1):
        assert row[-2] == str(k)
        assert float(row[-1]) < 1.0


def test_the_recursions_noise_is_the_expected_one(found):
    for row in found.tables[0].rows:
        assert float(row[2]) == pytest.approx(float(row[3]), rel=0.08)


def test_it_repeats_itself(found):
    again = identification.section(3)
    assert again.words == found.words
    assert again.tables == found.tables


def test_the_columns_and_ranks_are_those_of_the_thesis_where_it_is_right():
    table, words = looseness_matrices.jacobian_columns()
    assert [row[1] for row in table.rows] == ["1", "1, 2", "1, 2, 3", "1, 2, 3, 4"]
    assert table.rows[0][3] == "2, 3, 4"
    assert "does the opposite" in words
    told = printed("modelling")
    ranks, _ = looseness_matrices.jacobian_ranks(told)
    assert int(ranks.rows[0][2]) - int(ranks.rows[0][1]) == told["rank_added_by_slide"]
    assert int(ranks.rows[0][3]) - int(ranks.rows[0][1]) == told["rank_added_by_backlash"]


def test_play_conditions_the_inertia_worse_than_a_slide():
    told = printed("modelling")
    table, words, _ = looseness_matrices.inertia_condition(0, told)
    assert ("the order is the thesis's" in words) == told["backlash_ill_conditioned"]
    scaled = {row[0]: float(row[2]) for row in table.rows}
    assert scaled["vera, play in joint 1"] > 10 * scaled["vera, slide at link 1"]


def disagreement(name: str, gap: float, noise: float = 1e-5) -> Disagreement:
    return Disagreement(name=name, measures="", unit="m", gap=gap, noise=noise, model=0.0)


def test_the_step_is_said_to_matter_only_where_it_does():
    coarse = [disagreement("displacement", 20e-6), disagreement("velocity", 1.00)]
    fine = [disagreement("displacement", 30e-6), disagreement("velocity", 1.01)]
    rough = step_words(coarse, fine)
    assert "from 20 to 30 µm" in rough
    assert "by 1 % at most" in rough
    assert "ratio of 2 (3 with the finer step) is rough" in rough
    assert "is rough" not in step_words(coarse, [disagreement("displacement", 20.2e-6), fine[1]])


def test_the_finding_counts_the_models_in_which_the_gap_stands_out():
    stiff = [disagreement("velocity", 2e-5), disagreement("acceleration", 2e-5)]
    flexible = [disagreement("velocity", 5e-6), disagreement("acceleration", 2e-5)]
    words = finding(flexible, stiff, ["velocity", "acceleration"])
    assert "in 2 of 2 models on a stiff arm and in 1 of 2 on VERA" in words
    assert "of the two that the thesis chose, 1 show" in words
