"""TODO room scripts/suites/gap/simulator."""
