"""Report of a model-error analysis.

Data flow: figures -> spectra -> overlay -> text -> notebook -> parameters -> page -> write.
"""
