"""Tasks, results files and leaderboard of the benchmark of agents."""
