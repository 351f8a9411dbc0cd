"""TODO room scripts/suites/trust/kills."""
