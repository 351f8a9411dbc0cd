"""Robustness of the commands on generated arms and recordings.

Data flow: arms -> runs -> cases -> trial -> __main__.
"""
