"""TODO room scripts/suites."""
