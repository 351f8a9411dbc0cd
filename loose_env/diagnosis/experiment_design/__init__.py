"""TODO room loose_env/diagnosis/experiment_design."""
