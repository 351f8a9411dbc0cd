"""The command ``loose``: the instrument for measured data."""
