"""Proposal of a mapping written as a mapping file in TOML, with the reason above each line."""

from __future__ import annotations

from loose_env.importing.guessing.proposal import Proposal, ProposedColumn
from loose_env.importing.mapping.mapping_file import MAPPING_FORMAT
from loose_env.importing.readers.csv_list import quoted
from loose_env.importing.samples import Channel, ChannelKey

_MOST = 40
"""Channels without a column that are listed, at most."""


def proposal_text(proposal: Proposal, model: str) -> str:
    """Write a proposal as a mapping file.

    Parameters
    ----------
    proposal : Proposal
        The proposal.
    model : str
        Path of the model from the folder of the mapping; "" where it lies elsewhere, so that it
        is given on the command line.

    Returns
    -------
    str
        TOML; a line that lacks something is a comment.
    """
    lines = [f"format = {quoted(MAPPING_FORMAT)}"]
    lines.append(f"model = {quoted(model)}" if model else "# model: give it by --model")
    for name, log in proposal.logs.items():
        lines += ["", f"[sources.{name}]", *log.lines]
    lines += ["", "# Proposed by names, ranges and correlations: check every line.", "[columns]"]
    for each in proposal.columns:
        lines.append(f"# {_plain(each.reason)}")
        lines.append(f"{'# ' if each.open else ''}{_line(each, len(proposal.logs) > 1)}")
    lines += [f"# {_plain(note)}" for note in proposal.notes]
    if proposal.unassigned:
        lines.append("# Not assigned:")
    for name, channel in proposal.unassigned[:_MOST]:
        lines.append(f"# {_left(name, channel, len(proposal.logs) > 1)}")
    if len(proposal.unassigned) > _MOST:
        more = len(proposal.unassigned) - _MOST
        lines.append(f"# and {more} more: loose import --describe lists them")
    first = next(iter(proposal.logs))
    lines += ["", "[[runs]]", f"file = {quoted(first)}", 'condition = "suspect"  # or "healthy"']
    episodes = sum(len(log.file.episodes) for log in proposal.logs.values())
    if episodes:
        lines.append(f'episodes = "all"  # of {episodes}; or such as "0, 3-5"')
    return "\n".join(lines) + "\n"


def _left(source: str, channel: Channel, several: bool) -> str:
    parts = _place(source, channel.key, several)
    parts += [f"unit = {quoted(channel.unit)}"] if channel.unit else []
    return f'"sensor.?" = {{ {", ".join(parts)} }}'


def _place(source: str, key: ChannelKey, several: bool) -> list[str]:
    parts = [f"source = {quoted(source)}"] if several else []
    parts += [f"topic = {quoted(key.topic)}"] if key.topic else []
    return [*parts, f"channel = {quoted(key.channel)}"]


def _line(each: ProposedColumn, several: bool) -> str:
    parts = _place(each.candidate.source, each.candidate.key, several)
    scaling = each.scaling
    parts += [f"unit = {quoted(scaling.unit)}"] if scaling.unit else []
    parts += [f"scale = {scaling.scale:.9g}"] if scaling.scale != 1.0 else []
    parts += [f"sign = {each.sign}"] if each.sign != 1 else []
    parts += [f"offset = {scaling.offset:.9g}"] if scaling.offset else []
    return f"{quoted(each.column or 'sensor.?')} = {{ {', '.join(parts)} }}"


def _plain(words: str) -> str:
    return "".join(c if c.isprintable() else " " for c in words)
