"""Features of randomly excited runs: covariances, frequency responses, spectra.

Data flow: frequency_response -> frf_features -> incoherent_features -> features.
"""
