"""TODO room scripts/suites/trust/fuzz."""
