"""Training of the learned posteriors on simulated records.

Data flow: record_bank -> information_calibration -> novelty -> bank_storage -> train ->
ratio_training.
"""
