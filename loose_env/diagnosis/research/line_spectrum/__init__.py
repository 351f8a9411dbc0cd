"""TODO room loose_env/diagnosis/research/line_spectrum."""
