"""Sharded benchmarks, out-of-distribution arms, tuning.

Data flow: sharded -> out_of_distribution -> tuning -> tuning_sharded.
"""
