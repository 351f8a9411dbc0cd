"""Benchmark of agents: tasks in `episodes`, files in `results`, tables in `leaderboard`."""
