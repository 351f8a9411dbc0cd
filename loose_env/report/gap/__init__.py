"""Report of a model-error analysis.

Data flow: figures -> spectra -> rerun_file -> overlay -> text -> notebook -> deletions ->
parameters -> page -> write.
"""
