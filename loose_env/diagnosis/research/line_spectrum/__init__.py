"""Direction of looseness from line spectra of an arm with uncertain parameters.

Data flow: record_lines -> uncertain_arm -> model_error_fit -> direction.
"""
