"""Sections, their registry and run, the page and its plots.

Data flow: plots -> sections -> page.
"""
