"""Lines of progress: when they are printed, and what they say."""

from __future__ import annotations

import itertools

from loose_env.gap.residuals.progress import counted, reported, tick


class Clock:
    """A clock that is put forward by hand."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def test_nothing_is_printed_while_other_lines_are() -> None:
    clock, lines = Clock(), list[str]()
    with reported(lines.append, clock=clock) as say:
        for item in counted("fits", range(5)):
            clock.now += 4.0
            tick()
            say(f"fit {item}")
    assert lines == [f"fit {item}" for item in range(5)]


def test_no_silence_of_ten_seconds_and_a_time_that_is_left() -> None:
    clock, lines, times = Clock(), list[str](), list[float]()

    def keep(line: str) -> None:
        lines.append(line)
        times.append(clock.now)

    with reported(keep, clock=clock):
        for _ in counted("starts", range(100)):
            clock.now += 1.0
            tick()
    assert max(after - before for before, after in itertools.pairwise(times)) < 10
    assert all("starts: " in line and " of 100" in line for line in lines)
    done, left = (int(lines[-1].split(word)[0].split()[-1]) for word in (" of", " s left"))
    assert abs(left - (100 - done)) <= 2


def test_counts_within_counts_and_counts_of_at_most() -> None:
    clock, lines = Clock(), list[str]()
    with reported(lines.append, clock=clock):
        for _ in counted("sets", range(2)):
            for _ in counted("steps", range(8), most=True):
                clock.now += 7.0
                tick()
                break
    assert lines[0] == "  sets: 0 of 2; steps: 0 of at most 8"
    assert lines[1].startswith("  sets: 1 of 2, about 14 s left; steps: 0 of at most 8")


def test_without_a_reporter_items_pass_and_nothing_happens() -> None:
    tick()
    assert list(counted("items", "abc")) == ["a", "b", "c"]
