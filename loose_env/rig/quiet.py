"""Keeps the engine's warnings to ourselves; see `loose_env.arms.quiet`."""

from __future__ import annotations

from loose_env.arms.quiet import quiet

__all__ = ["quiet"]
