"""Training of the learned posterior on simulated records.

Data flow: record_bank -> information_calibration -> novelty -> bank_storage -> train.
"""
