"""The one harness of command lines: options of all kinds, errors in one line, exit codes."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import pytest
from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from loose_env.cli.command import command, commands, one_of, parsed
from loose_env.errors import InvalidData
from loose_env.io import Checked, Count, Positive


@dataclass(frozen=True, kw_only=True)
class Inner(Checked):
    """Settings inside others."""

    rate_hz: Positive = 100.0
    """Sampling rate [Hz]."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a script."""

    model: Positional[Path]
    """Model of the arm, 5 % [m]."""
    more: Positional[tuple[Path, ...]] = ()
    """Further models."""
    cases: Annotated[Count, arg(aliases=["-n"])] = 8
    """Cases of a run."""
    level: Literal["low", "high"] = "low"
    """Level of the excitation."""
    arms: tuple[Annotated[str, one_of(("vera", "planar"))], ...] = ("vera",)
    """Arms."""
    span: tuple[float, float] | None = None
    """Range [s]."""
    keep: bool = True
    """Keep the rows."""
    file: UseAppendAction[tuple[Path, ...]] = ()
    """Files."""
    show: tuple[str, ...] | None = None
    """Print what is stored."""
    inner: OmitArgPrefixes[Inner] = field(default_factory=Inner)


def test_every_kind_of_option_is_read() -> None:
    words = "a.xml b.xml -n 3 --level high --arms planar vera --span -1 2e-3 --no-keep"
    found = parsed("study", "", Settings, [*words.split(), "--file=a", "--file", "b", "--show"])
    assert (found.model, found.more) == (Path("a.xml"), (Path("b.xml"),))
    assert (found.cases, found.level, found.arms) == (3, "high", ("planar", "vera"))
    assert (found.span, found.keep, found.show) == ((-1.0, 0.002), False, ())
    assert found.file == (Path("a"), Path("b"))
    plain = parsed("study", "", Settings, ["a.xml", "--rate-hz", "50"])
    assert plain == Settings(model=Path("a.xml"), inner=Inner(rate_hz=50.0))


def test_given_options_come_before_the_defaults_of_an_earlier_run() -> None:
    earlier = Settings(model=Path("a.xml"), cases=3, keep=False, inner=Inner(rate_hz=2.0))
    found = parsed("study", "", Settings, ["b.xml", "--cases", "8"], default=earlier)
    assert found == Settings(model=Path("b.xml"), cases=8, keep=False, inner=Inner(rate_hz=2.0))


def test_the_help_has_the_docstrings_of_the_fields(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        command("study", "What it finds.", Settings, print, ["--help"])
    said = capsys.readouterr().out
    assert end.value.code == 0
    for words in ("What it finds.", "5 % [m].", "--cases", "(default: 8)", "--rate-hz", "MODEL"):
        assert words in said


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("", "MODEL must be given"),
        ("m --cases x", "--cases takes INT; got 'x'"),
        ("m --rate-hz", "--rate-hz takes FLOAT"),
        ("m --span 1", "--span takes {FLOAT FLOAT}; got '1'"),
        ("m --level mid", "--level must be one of low, high; got 'mid'"),
        ("m --arms vera vero", "--arms must be one of vera, planar; got 'vero'"),
        ("m --cuses 3", "unrecognized: --cuses 3"),
        ("m --cases 0", "--cases must be a whole number, 1 or more; got 0"),
        ("m --rate-hz 0", "--rate-hz must be positive and finite; got 0.0"),
    ],
)
def test_a_wrong_command_line_ends_in_one_line(
    words: str, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        command("study", "", Settings, print, words.split())
    assert end.value.code == 2
    assert capsys.readouterr().err == f"study: {line}; --help lists the options\n"


@pytest.mark.parametrize("kind", [InvalidData, OSError, ImportError, ValueError])
def test_an_error_of_the_action_is_one_line(kind: type[Exception]) -> None:
    def fail(settings: Settings) -> None:
        raise kind("two\n  lines")

    with pytest.raises(SystemExit, match=r"^study: two lines$"):
        command("study", "", Settings, fail, ["m"])


def test_a_fault_of_the_program_keeps_its_trace() -> None:
    def fail(settings: Settings) -> None:
        raise KeyError("unforeseen")

    with pytest.raises(KeyError):
        command("study", "", Settings, fail, ["m"])


def test_an_interrupt_says_how_to_go_on(capsys: pytest.CaptureFixture[str]) -> None:
    def stop(settings: Settings) -> None:
        raise KeyboardInterrupt

    with pytest.raises(SystemExit) as end:
        command("study", "", Settings, stop, ["m"], interrupted="the same command goes on")
    assert end.value.code == 130
    assert capsys.readouterr().err == "study: interrupted; the same command goes on\n"


def test_the_first_word_names_a_subcommand(capsys: pytest.CaptureFixture[str]) -> None:
    actions = {"run": (Settings, lambda given: print(given.cases)), "show": (Inner, print)}
    commands("study", "Two things.", actions, ["run", "m", "-n", "4"])
    commands("study", "Two things.", actions, ["--help"])
    said = capsys.readouterr().out
    assert said.startswith("4\nusage: study COMMAND")
    assert "  show: Settings inside others." in said
    with pytest.raises(SystemExit) as end:
        commands("study", "Two things.", actions, ["ran"])
    assert end.value.code == 2
    assert "'ran' is no command; there are run, show" in capsys.readouterr().err


@pytest.mark.parametrize("word", ["--help", "--version"])
def test_a_reader_who_has_gone_is_no_error(word: str) -> None:
    read, write = os.pipe()
    os.close(read)
    code = f"from loose_env.cli.main import main; raise SystemExit(main(['{word}']))"
    done = subprocess.run(
        [sys.executable, "-u", "-c", code], stdout=write, stderr=subprocess.PIPE, check=False
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (0, b"")
