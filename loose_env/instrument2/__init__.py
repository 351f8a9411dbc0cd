"""Looseness of a real arm: a plan to shake it, and where its records say that something knocks."""
