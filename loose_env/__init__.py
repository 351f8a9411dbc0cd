"""Diagnosis of looseness in robot arms: `diagnose`, `explain_gap`, Gymnasium environments.

Importing the package registers its environments with Gymnasium. `diagnose`, `explain_gap` and
`simulator` load the rest of the package when they are first used:

    import loose_env
    found = loose_env.diagnose("session/recording")
    print(found.headline)
"""

import importlib
from typing import TYPE_CHECKING, Any

from loose_env.registration import register
from loose_env.version import __version__

if TYPE_CHECKING:
    from loose_env.api import diagnose, explain_gap
    from loose_env.simulation import simulator

__all__ = ["__version__", "diagnose", "explain_gap", "register", "simulator"]

_LATER = {"diagnose": "api", "explain_gap": "api", "simulator": "simulation"}
"""Names by their module, whose imports take a second."""

register()


def __getattr__(name: str) -> Any:
    """Import a name when it is asked for."""
    if name in _LATER:
        return getattr(importlib.import_module(f"loose_env.{_LATER[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Names of the package, those that are imported later among them."""
    return sorted({*globals(), *_LATER})
