"""TODO room loose_env/thesis/methods/looseness."""
