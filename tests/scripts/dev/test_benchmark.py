"""The table of the reduced engine beside MuJoCo's."""

from __future__ import annotations

import pytest

from loose_env.rig import ReducedRig
from scripts.dev import benchmark


def test_both_engines_are_timed_in_one_run(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("numba")
    assert isinstance(benchmark.new_batch("loose_env/Vera-v0", 1, engine="reduced").rig, ReducedRig)
    monkeypatch.setattr(benchmark, "subprocess_seconds_per_record", lambda *_: 0.05)
    benchmark.print_engines(["loose_env/Vera-v0"], arms=[1, 2], rounds=1, commit="none")
    _, head, *rows = capsys.readouterr().out.strip().splitlines()
    assert [row.split()[1:-6] for row in rows] == [["1.2", "s"], ["1.2", "s"], ["mixed"], ["mixed"]]
    for row, arms in zip(rows, ["1", "2"] * 2, strict=True):
        assert len(row) == len(head)  # the columns stand below each other
        count, rate, _, earlier, mujoco, loop = row.split()[-6:]
        assert (count, earlier) == (arms, "nan")  # there is no such commit
        assert float(loop) == pytest.approx(0.05 * float(rate), rel=0.05)
        assert float(mujoco) > 0


def test_an_engine_that_cannot_run_is_said_and_the_rest_goes_on(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from loose_env.errors import InvalidSetting

    def refuse(*_: object) -> None:
        raise InvalidSetting("the reduced engine needs numba")

    monkeypatch.setattr(benchmark, "engine_times", refuse)
    benchmark.print_engines(["loose_env/Vera-v0", "loose_env/Planar-v0"], arms=[1], rounds=1)
    lines = capsys.readouterr().out.strip().splitlines()
    assert [line.split()[0] for line in lines[2:]] == ["loose_env/Vera-v0", "loose_env/Planar-v0"]
    assert all(line.endswith("needs numba") for line in lines[2:])
