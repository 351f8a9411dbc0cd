from __future__ import annotations

import pytest

from loose_env.errors import InvalidData
from loose_env.gap.data.holdout_split import split_runs


def test_families_of_motions_are_held_out_whole() -> None:
    names = ["swing_slow.csv", "hold.csv", "swing_fast.csv", "step_small.csv", "circle.csv",
             "step_large.csv", "ramp.csv", "chirp.csv"]  # fmt: skip
    for share in (0.2, 0.4, 0.6):
        fitted, held = split_runs(names, share=share)
        assert sorted(fitted + held) == list(range(len(names)))
        assert fitted
        assert held
        for first, second in ((0, 2), (3, 5)):
            assert (first in held) == (second in held)


@pytest.mark.parametrize(
    "names",
    [
        [f"run-{k:02d}.parquet" for k in range(8)],
        [f"run{k}.csv" for k in range(8)],
        [f"day2/test_{k}.csv" for k in "abcdefgh"],
    ],
)
def test_runs_that_only_a_number_tells_apart_are_no_family(names: list[str]) -> None:
    assert split_runs(names) == ([0, 1, 2, 4, 5, 6], [3, 7])


@pytest.mark.parametrize("share", [0.6, 0.8, 0.9, 0.99])
@pytest.mark.parametrize("count", [2, 3, 5])
def test_a_large_share_leaves_a_run_to_fit_to(share: float, count: int) -> None:
    fitted, held = split_runs([f"run-{k}.csv" for k in range(count)], share=share)
    assert fitted and held
    assert sorted(fitted + held) == list(range(count))


def test_runs_to_hold_out_can_be_named() -> None:
    names = ["swing_slow.csv", "hold.csv", "swing_fast.csv"]
    assert split_runs(names, held_out=["swing"]) == ([1], [0, 2])
    assert split_runs(names, held_out=["hold.csv"]) == ([0, 2], [1])
    with pytest.raises(InvalidData, match=r"no run to hold out is called 'jump'.*hold\.csv"):
        split_runs(names, held_out=["jump"])
    with pytest.raises(InvalidData, match="none is left to fit to"):
        split_runs(names, held_out=["swing", "hold"])
