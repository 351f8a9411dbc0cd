"""TODO room loose_env/diagnosis/research/particles."""
