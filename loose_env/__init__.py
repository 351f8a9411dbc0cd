"""Find the loose link in a robot arm, and learn to find it faster."""

__version__ = "0.1.0"
