"""Blind recordings for the gap tool: made by an arm integrated without MuJoCo, truth kept apart.

`arms`, `dynamics` and `simulate` hold the arms in numbers and their integration; `effects` and
`drive_effects` what a model can lack; `machine` motions and sensors; `cases` the list of cases.
Nothing of these imports the tool under test. `run` gives recordings to a tool and grades it.

Compiled functions are kept on disk (numba), and the compiler does not see that a function inside
another one has changed: after an edit of `dynamics` remove `__pycache__`.
"""
