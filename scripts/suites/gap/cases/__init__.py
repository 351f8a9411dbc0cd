"""TODO room scripts/suites/gap/cases."""
