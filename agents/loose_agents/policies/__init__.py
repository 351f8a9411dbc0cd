"""Policies that choose the next record, and agents that search by rules of their own."""
