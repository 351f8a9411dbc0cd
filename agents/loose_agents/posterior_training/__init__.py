"""Training of the learned posterior on simulated records.

Data flow: simulated_records -> information_calibration -> novelty -> record_features ->
bank_storage -> train.
"""
