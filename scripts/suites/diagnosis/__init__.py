"""Blind recordings for `loose diagnose`: an arm integrated without MuJoCo, truth kept apart.

`cases` draws the arms and what is loose in them, `measuring` takes their runs with the integrator
of `scripts.suites.gap`, `blind` writes recordings and runs the tool on them in a folder that holds
no truth, `grade` marks what it said and prints the table. Run it as

    python -m scripts.suites.diagnosis --out DIR

Development used the seed 1, tables the seed that is the default.
"""
