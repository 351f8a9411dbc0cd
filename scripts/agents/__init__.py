"""Scripts that train, tune and compare agents."""
