"""TODO room loose_env/thesis/ch6_experiments/shaken_vera."""
