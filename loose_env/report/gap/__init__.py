"""Report of a model-error analysis.

Data flow: figures -> spectra -> overlay -> text -> parameters -> page -> write.
"""
