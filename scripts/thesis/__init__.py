"""The thesis's methods, rigs and experiments, beside the printed results."""
