from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from typing import Literal

import pytest

from loose_env.cli.options import add_settings, settings_of
from loose_env.io import field_words


@dataclass(frozen=True, kw_only=True)
class Inner:
    most: int = 3
    """Most effects named."""
    sureness: float = 3.5
    """Lead that is believed [standard deviations]."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    tolerance: float = 0.03
    """Share within which figures are known, 3 % by default."""
    seed: int = 0
    """Of all random numbers."""
    way: Literal["short", "long"] = "short"
    """How far it goes."""
    horizons: tuple[float, ...] = (0.1, 0.5)
    """How long [s]."""
    held_out: str | None = None
    """A run that is held out."""
    polish: bool = True
    """Whether the fit is repeated."""
    naming: Inner = field(default_factory=Inner)
    """When an effect counts."""


def parsed(*words: str) -> Settings:
    parser = argparse.ArgumentParser()
    add_settings(parser, Settings)
    return settings_of(parser.parse_args(words), Settings)


def test_without_options_the_defaults_hold() -> None:
    assert parsed() == Settings()


def test_every_field_has_an_option_of_its_type() -> None:
    found = parsed(
        *("--tolerance", "0.05", "--seed", "7", "--way", "long", "--horizons", "1", "2"),
        *("--held-out", "a.csv", "--no-polish", "--naming-most", "1"),
    )
    assert found == Settings(
        tolerance=0.05, seed=7, way="long", horizons=(1.0, 2.0), held_out="a.csv", polish=False,
        naming=Inner(most=1),
    )  # fmt: skip


def test_help_is_the_docstring_under_the_field_with_its_unit_and_default() -> None:
    parser = argparse.ArgumentParser()
    add_settings(parser, Settings)
    said = " ".join(parser.format_help().split())
    assert "Share within which figures are known, 3 % by default (default: 0.03)" in said
    assert "Lead that is believed [standard deviations] (default: 3.5)" in said


def test_fields_left_out_keep_their_defaults() -> None:
    parser = argparse.ArgumentParser()
    add_settings(parser, Settings, leave_out=("seed", "naming-most"))
    with pytest.raises(SystemExit):
        parser.parse_args(["--seed", "1"])
    with pytest.raises(SystemExit):
        parser.parse_args(["--naming-most", "1"])
    assert settings_of(parser.parse_args([]), Settings) == Settings()


def test_a_field_that_no_option_can_hold_is_refused() -> None:
    @dataclass(frozen=True)
    class Odd:
        table: dict[str, int] = field(default_factory=dict)

    with pytest.raises((TypeError, NameError)):
        add_settings(argparse.ArgumentParser(), Odd)


def test_words_of_fields_are_read_from_the_source() -> None:
    assert field_words(Inner)["most"] == "Most effects named."
