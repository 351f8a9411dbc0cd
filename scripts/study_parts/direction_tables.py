"""Tables of the study of directions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from loose_agents.execution.study import Row, StudyRun

from loose_env.diagnosis import Ending

__all__ = ["GAPS", "WANTED", "show"]

GAPS = (0.03e-3, 0.4e-3)
"""Range of the gaps, log-uniform [m]."""
OPEN = 0.3
"""Change of transmission over the transmission from which a seat counts as open [1]."""
WANTED = (20.0, 10.0, 5.0)
"""Half angles at which the stopping rule ends [deg]."""


def _median(values: Sequence[float]) -> str:
    return f"{np.median(values):7.1f}" if len(values) else "      -"


def print_errors(rows: Sequence[Row]) -> None:
    """Print the table of median errors, binned by gravity along the seat and by |dB|/|B|."""
    print(
        "Median angle from the estimated direction to the true one [deg]\n\n"
        f"{'gravity along seat':20}{'|dB|/|B|':14}{'cases':>7}{'healthy ref.':>14}"
        f"{'nominal model':>15}{'lowest coherence':>18}"
    )
    gravities = ((0.0, 0.1), (0.1, 0.3), (0.3, 0.6), (0.6, 1.01))
    ratios = ((0.0, 0.03), (0.03, 0.1), (0.1, 0.3), (0.3, np.inf))

    def line(name: str, ratio: str, chosen: list[Row]) -> None:
        print(
            f"{name:20}{ratio:14}{len(chosen):>7}"
            f"{_median([r['healthy']['error'] for r in chosen]):>14}"
            f"{_median([r['nominal']['error'] for r in chosen]):>15}"
            f"{_median([r['lowest'] for r in chosen]):>18}"
        )

    for g_low, g_high in (*gravities, (0.0, np.inf)):
        name = f"{g_low:g} to {min(g_high, 1):g} g" if np.isfinite(g_high) else "any"
        for low, high in ratios:
            own = [r for r in rows if g_low <= r["gravity"] < g_high and low <= r["ratio"] < high]
            line(name, f"{low:g} to {high:g}" if np.isfinite(high) else f"over {low:g}", own)
    line("any", "one column 0.3", [r for r in rows if r["best_ratio"] >= OPEN])


def print_coverage(rows: Sequence[Row]) -> None:
    """Print how often the 95 % region holds the true direction."""
    print(
        "\nShare of 95 % regions that hold the true direction, and their median half angle\n\n"
        f"{'records':26}{'change of':12}{'cases':>7}{'coverage':>10}{'half angle':>12}"
        f"{'narrower than 30':>19}{'coverage':>10}{'half angle':>12}"
    )
    for name, field in (
        ("each joint in turn", "healthy"),
        ("each joint in turn", "nominal"),
        ("one joint", "single_healthy"),
        ("one joint", "single_nominal"),
    ):
        found = [r[field] for r in rows]
        sharp = [e for e in found if e["half_angle"] < 30.0]
        against = "healthy" if field.endswith("healthy") else "nominal"
        print(
            f"{name:26}{against:12}{len(found):>7}{np.mean([e['inside'] for e in found]):>10.1%}"
            f"{np.median([e['half_angle'] for e in found]):>11.1f}°{len(sharp):>19}"
            f"{np.mean([e['inside'] for e in sharp]) if sharp else np.nan:>10.1%}"
            f"{np.median([e['half_angle'] for e in sharp]) if sharp else np.nan:>11.1f}°"
        )


def print_ranks(rows: Sequence[Row], healthy: Sequence[Row], several: Sequence[Row]) -> None:
    """Print how many directions the change is found to have."""
    print(
        "\nDirections found in the change, share of cases\n\n"
        f"{'arm':44}{'change of':12}{'cases':>7}{'none':>8}{'one':>8}{'more':>8}"
    )

    def line(name: str, against: str, ranks: Sequence[int]) -> None:
        found = np.array(ranks)
        shares = [np.mean(found == 0), np.mean(found == 1), np.mean(found > 1)]
        text = "".join(f"{s:>8.0%}" for s in shares) if len(found) else ""
        print(f"{name:44}{against:12}{len(found):>7}{text}")

    line("healthy", "nominal", [r["rank"] for r in healthy])
    for name, low, high in (
        ("one slide, |dB|/|B| under 0.03", 0.0, 0.03),
        ("one slide, |dB|/|B| 0.03 to 0.3", 0.03, OPEN),
        ("one slide, |dB|/|B| over 0.3", OPEN, np.inf),
    ):
        chosen = [r for r in rows if low <= r["ratio"] < high]
        line(name, "healthy", [r["healthy"]["rank"] for r in chosen])
        line(name, "nominal", [r["nominal"]["rank"] for r in chosen])
    for against in ("healthy", "nominal"):
        ranks = [r[f"rank_{against}"] for r in several if r["moves"]]
        line("two slides, both change |dB|/|B| by 0.03", against, ranks)


def print_stopping(rows: Sequence[Row]) -> None:
    """Print the cost of the stopping rule for several wanted angles."""
    print(
        "\nMeasuring as long as the angle needs (each joint, up to 4.8 s, against the nominal "
        "model)\n\n"
        f"{'half angle wanted':>18}{'reached':>9}{'floor':>7}{'spent':>7}"
        f"{'s where reached':>17}{'error there':>13}{'inside':>8}"
    )
    for wanted in WANTED:
        own = [r for r in rows if r["wanted"] == wanted]
        done = [r for r in own if r["ending"] == Ending.REACHED.name]
        shares = [np.mean([r["ending"] == e.name for r in own]) for e in Ending]
        print(
            f"{wanted:>17.0f}°{shares[0]:>9.0%}{shares[1]:>7.0%}{shares[2]:>7.0%}"
            f"{np.median([r['seconds'] for r in done]) if done else np.nan:>16.1f}s"
            f"{np.median([r['error'] for r in done]) if done else np.nan:>12.1f}°"
            f"{np.mean([r['inside'] for r in done]) if done else np.nan:>8.0%}"
        )


def show(rows: list[Row], settings: Any, path: Path, run: StudyRun) -> None:
    """Print all tables."""
    slides, healthy, several, stopping = (
        [r for r in rows if r["part"] == part]
        for part in ("slide", "healthy", "two slides", "stopping")
    )
    print(
        f"{settings.arm}: {len(slides)} cases, gaps {1e3 * GAPS[0]:g} to {1e3 * GAPS[1]:g} mm, "
        f"seed {settings.seed}\n"
    )
    print_errors(slides)
    print_coverage(slides)
    print_ranks(slides, healthy, several)
    if stopping:
        print_stopping(stopping)
