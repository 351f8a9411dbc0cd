"""Version of the package: read without loading anything."""

__all__ = ["__version__"]

__version__ = "0.1.0"
