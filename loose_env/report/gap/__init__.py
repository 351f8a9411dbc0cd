"""Report of a model-error analysis.

Data flow: figures -> spectra -> rerun_file -> overlay -> text -> notebook -> quick ->
deletions -> parameters -> page -> write.
"""
