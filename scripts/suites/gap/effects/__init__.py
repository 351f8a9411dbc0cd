"""TODO room scripts/suites/gap/effects."""
