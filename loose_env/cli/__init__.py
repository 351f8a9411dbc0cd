"""The command ``loose``: the instrument for measured data."""

from loose_env.cli.options import field_words

__all__ = ["field_words"]
