"""Print what `loose gap` finds in recordings, one after the other, with verdicts and CPU time.

python scripts/gap_logs.py RECORDING [RECORDING ...]
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tyro.conf import Positional

from loose_env.cli.command import command
from loose_env.gap import find_gap
from loose_env.recording import read_recording


@dataclass(frozen=True, kw_only=True)
class LogSettings:
    """Recordings."""

    recordings: Positional[tuple[Path, ...]]
    """Folders of recordings."""


def run(given: LogSettings) -> None:
    """Print effects, verdicts and CPU time of each recording."""
    for folder in given.recordings:
        start = time.process_time()
        answer = find_gap(read_recording(folder))
        decision = answer.decision
        evidence = answer.selection.evidence
        motion = evidence.balance.motion
        print(
            f"== {folder.name}: {motion.runs[0].form}, band {motion.band:.1f} Hz, "
            f"{len(evidence.terms)} terms, {evidence.tolerances} tolerances, "
            f"{time.process_time() - start:.1f} s CPU"
        )
        for e in answer.exact:
            words = ", ".join(f"{t.effect.kind}@{t.effect.where}" for t in e.terms)
            print(f"  exact {e.total:.0f}: {words}; rms {np.round(e.rms, 1)}")
        for f in sorted(decision.findings, key=lambda f: f.term.name):
            values = ", ".join(
                f"{p.name} {v:.4g} ({a:.4g} to {b:.4g}) {p.unit}"
                for p, v, a, b in zip(
                    f.term.effect.parameters, f.values, f.low, f.high, strict=True
                )
            )
            word = "NAMED" if f.named else "     "
            print(
                f"  {word} {f.term.effect!r} {f.term.contact}: {values}; p {f.probability:.2f}, "
                f"z {f.z:.1f}, held-out {f.by_run:+.0f} by run {f.by_stretch:+.0f} by stretch"
            )
        if decision.rivals:
            print("  rivals:", ", ".join(f"{k}@{w} {p:.2f}" for p, k, w in decision.rivals[:8]))
        for j in decision.joints:
            print(
                f"  {j.joint}: {j.verdict} {', '.join(j.effects)} ({j.before:.3g} -> {j.after:.3g})"
            )
        pull = decision.fit.values[: evidence.tolerances]
        print(f"  tolerances {float(pull @ pull):.1f}", flush=True)


if __name__ == "__main__":
    command("gap_logs", __doc__, LogSettings, run)
