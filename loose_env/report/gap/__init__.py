"""Report of a model-error analysis.

Data flow: figures -> spectra -> rerun_file -> overlay -> effects -> text -> notebook -> quick ->
parameters -> page -> write.
"""
