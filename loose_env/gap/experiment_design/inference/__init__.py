"""Posterior over missing effects from measured motions, and the information of further ones.

Data flow: local_models -> posterior -> expansion -> screening -> simulations -> exact_fit ->
comparison -> belief -> information.
"""
