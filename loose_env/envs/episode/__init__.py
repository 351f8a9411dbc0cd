"""State, actions and observations of episodes.

Data flow: pose_encoding -> actions -> observation -> raw_observation -> reset_options -> state
-> true_arm -> batch.
"""
