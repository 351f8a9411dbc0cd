"""Blind recordings for diagnosis; development used the seed 1, tables the default."""
