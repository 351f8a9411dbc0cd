"""Report of a model-error analysis.

Data flow: figures -> spectra -> text -> notebook -> page -> write.
"""
