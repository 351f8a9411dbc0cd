"""TODO room scripts/dev."""
