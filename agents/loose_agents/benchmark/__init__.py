"""Sharded evaluation, out-of-distribution arms, the public benchmark, tuning.

Data flow: sharded -> out_of_distribution -> tasks -> results -> reference -> submission ->
leaderboard -> tuning -> tuning_sharded.
"""
