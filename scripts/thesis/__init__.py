"""Reproduction of the thesis: its methods, rigs and experiments beside the printed results."""
