"""TODO room scripts/studies."""
