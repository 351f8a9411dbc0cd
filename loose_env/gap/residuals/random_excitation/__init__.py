"""TODO room loose_env/gap/residuals/random_excitation."""
