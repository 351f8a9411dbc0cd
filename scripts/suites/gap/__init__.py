"""Blind recordings for the gap tool: made by an arm integrated without MuJoCo, truth kept apart.

`simulator` holds the arms in numbers, their equations of motion, the torques that act in the joints
and the integration; `effects` what a model can lack, `cases` the list of cases with their commands,
readings and sizes, and the writing of recordings. Nothing of these imports MuJoCo or the tool under
test. `grading` runs a tool on a recording and marks its result, `run.py` runs the suite. `rivals`
holds other methods that can be run in place of the tool, `public` the benchmark for anyone's, and
`studies` what is measured beside: edit test, calibration, cost, measured recordings.

Compiled functions are kept on disk (numba). The compiler does not see that a function inside
another one has changed: after an edit of `dynamics` or `laws` remove `__pycache__`.
"""
