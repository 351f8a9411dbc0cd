"""Chapter 6: experiments.

Data flow: arm -> shaken_vera -> slide.
"""
