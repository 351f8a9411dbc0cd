"""Find the loose link in a robot arm, and learn to find it faster.

Importing the package registers its environments with Gymnasium.
"""

from loose_env.registration import register

__all__ = ["__version__", "register"]
__version__ = "0.1.0"

register()
