"""Blind recordings for the gap tool: made by an arm integrated without MuJoCo, truth kept apart.

`figures` holds the arms in numbers, `dynamics` their equations of motion, `laws` the torques that
act in the joints, `simulate` the integration, `effects` and `outside` what a model can lack,
`motions` the commands, `sensing` the readings, `sizing` how large an effect must be to be seen,
`cases` the list of cases, `recordings` the writing, `grade` the marks, `alternatives` what data
cannot tell apart, `tables` what is printed. Nothing of these imports MuJoCo or the tool under test.
`tool` runs the tool on one recording, `one_case` a case from its drawing to its marks, and
`scripts/suites/gap/run.py` the suite; `edits` takes a named effect off machine and model; `rivals`
holds other methods that can be run in place of the tool;
`fingerprint` tells rows of other code apart.

Compiled functions are kept on disk (numba). The compiler does not see that a function inside
another one has changed: after an edit of `dynamics` or `laws` remove `__pycache__`.
"""
