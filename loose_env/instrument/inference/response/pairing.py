"""Spectral lines of runs under test, paired with healthy references, leakage predicted."""

from __future__ import annotations

from collections.abc import MutableMapping, Sequence
from dataclasses import replace

from loose_env.instrument.data.paired_runs import HeldRun, as_driven, paired_lines
from loose_env.instrument.data.spectral_lines import Lines
from loose_env.instrument.inference.response.frequency_response import with_leakage
from loose_env.instrument.inference.response.uncertain_linear_arm import UncertainArm


def beside_references(
    uncertain: UncertainArm, held: Sequence[HeldRun], known: MutableMapping[int, Lines]
) -> list[Lines]:
    """Lines of all runs, those under test beside the same run of the healthy arm."""
    references = [each for each in held if each.lines.healthy]
    for each in held:
        number = each.lines.number
        if each.lines.healthy or number in known:
            continue
        pair = paired_lines(uncertain.arm, each, references)
        if pair is not None:
            own, other = (with_leakage(uncertain.at(one.pose), one) for one in pair)
            known[number] = replace(own, beside=as_driven(uncertain.arm, other, own))
    return [known.get(each.lines.number, each.lines) for each in held]
