"""Other methods as tools of the suite: what a competent user would try on the same recordings.

Data flow: joint_data -> inverse_dynamics -> candidates -> regression -> least_squares,
group_lasso, residual_network; sysid_parameters -> sysid. `joint_data` reads the recording,
low-passes and decimates it, `inverse_dynamics` and `candidates` make the columns of the regressor,
`regression` fits them with the nominal parameters as a prior, `results` writes what was found.
Each method is a function of recording, result folder and tolerance, as the tool under test is.
No method imports the suite's simulator, cases, effects or marks; the command (`__main__`), which
prints the table, does.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

__all__ = ["METHODS", "run_method"]

METHODS: dict[str, tuple[str, str]] = {
    "sysid": ("sysid", "run_sysid"),
    "least_squares": ("least_squares", "run_least_squares"),
    "stepwise_bic": ("least_squares", "run_stepwise_bic"),
    "group_lasso": ("group_lasso", "run_group_lasso"),
    "residual_network": ("residual_network", "run_residual_network"),
}
"""Modules and functions of the methods, by name."""


def run_method(recording: Path, folder: Path, tolerance: float, *, name: str) -> None:
    """Run a method on a recording; its module is loaded now, with the packages that it needs.

    Parameters
    ----------
    recording : Path
        Folder of the recording.
    folder : Path
        Folder of the result, which exists.
    tolerance : float
        Largest relative error of the nominal parameters.
    name : str
        One of `METHODS`.
    """
    module, function = METHODS[name]
    getattr(import_module(f"{__name__}.{module}"), function)(recording, folder, tolerance)
