"""Main comparison: agents and constant baselines diagnose the same hidden faults on VERA.

Usage: python scripts/run_demo.py [options of scripts/agents/compare.py]
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from scripts.agents import compare

EPISODES = 300
AGENTS = ("greedy", "ppo", "random", *compare.CLASSICAL)


def main() -> None:
    """Compare the agents on VERA and write the page; later options win.

    In this process and with rows as JSON: it needs no package beyond those of `make run`.
    """
    plain = ["--workers", "1", "--rows", "json"]
    agents = ["--agents", *AGENTS]
    compare.main(["--page", "--episodes", str(EPISODES), *agents, *plain, *sys.argv[1:]])


if __name__ == "__main__":
    main()
