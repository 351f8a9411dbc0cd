"""The table of the reduced engine beside MuJoCo's."""

from __future__ import annotations

import pytest

from loose_env.rig import ReducedRig
from scripts.dev import benchmark


def test_both_engines_are_timed_in_one_run(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("numba")
    assert isinstance(benchmark.new_batch("loose_env/Vera-v0", 1, engine="reduced").rig, ReducedRig)
    benchmark.print_engines(["loose_env/Vera-v0"], arms=2, rounds=1)
    head, row = capsys.readouterr().out.strip().splitlines()
    assert len(row) == len(head)  # the columns stand below each other
    env_id, length, seconds, milliseconds, unit, rate, every, one = row.split()
    assert (env_id, length, seconds, unit) == ("loose_env/Vera-v0", "1.2", "s", "ms")
    assert float(rate) == pytest.approx(1e3 / float(milliseconds), rel=0.05)
    assert float(every) > 0
    assert float(one) > 0


def test_an_engine_that_cannot_run_is_said_and_the_rest_goes_on(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from loose_env.errors import InvalidSetting

    def refuse(*_: object) -> None:
        raise InvalidSetting("the reduced engine needs numba")

    monkeypatch.setattr(benchmark, "engine_times", refuse)
    benchmark.print_engines(["loose_env/Vera-v0", "loose_env/Planar-v0"], arms=1, rounds=1)
    lines = capsys.readouterr().out.strip().splitlines()
    assert [line.split()[0] for line in lines[1:]] == ["loose_env/Vera-v0", "loose_env/Planar-v0"]
    assert all(line.endswith("needs numba") for line in lines[1:])
