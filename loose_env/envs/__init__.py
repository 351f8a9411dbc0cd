"""Gymnasium environments in which a fault is hidden in an arm."""
