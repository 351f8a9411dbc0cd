"""A proposal as a mapping file in TOML, with the reason above each line."""

from __future__ import annotations

from loose_env.importing.guessing.proposal import Proposal, ProposedColumn
from loose_env.importing.mapping.mapping_file import MAPPING_FORMAT
from loose_env.importing.readers.csv_list import quoted


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
    first = next(iter(proposal.logs))
    lines += ["", "[[runs]]", f"file = {quoted(first)}", 'condition = "suspect"  # or "healthy"']
    episodes = sum(len(log.file.episodes) for log in proposal.logs.values())
    if episodes:
        lines.append(f'episodes = "all"  # of {episodes}; or such as "0, 3-5"')
    return "\n".join(lines) + "\n"


def _line(each: ProposedColumn, several: bool) -> str:
    key = each.candidate.key
    parts = [f"source = {quoted(each.candidate.source)}"] if several else []
    parts += [f"topic = {quoted(key.topic)}"] if key.topic else []
    parts.append(f"channel = {quoted(key.channel)}")
    scaling = each.scaling
    parts += [f"unit = {quoted(scaling.unit)}"] if scaling.unit else []
    parts += [f"scale = {scaling.scale:.9g}"] if scaling.scale != 1.0 else []
    parts += [f"sign = {each.sign}"] if each.sign != 1 else []
    parts += [f"offset = {scaling.offset:.9g}"] if scaling.offset else []
    return f"{quoted(each.column or 'sensor.?')} = {{ {', '.join(parts)} }}"


def _plain(words: str) -> str:
    return "".join(c if c.isprintable() else " " for c in words)
