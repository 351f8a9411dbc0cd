"""TODO room scripts/suites/gap/grading."""
