"""The thesis's chapters, computed and set beside the printed results.

Data flow: methods -> printed -> rigs -> shared -> ch3_modelling -> ch5_simulation ->
ch6_experiments -> ch4_diagnosis.
"""

from loose_env.thesis.ch6_experiments.shaken_vera.cases import printed_healthy
from loose_env.thesis.rigs.cylindrical import cylindrical
from loose_env.thesis.rigs.shaken_vera import (
    PROXIMAL,
    STIFF_PIN_FACTOR,
    Pin,
    ShakenVeraParameters,
    shaken_vera,
)
from loose_env.thesis.shared.page import render_thesis_page
from loose_env.thesis.shared.sections import SECTIONS, Outcome, choose, first_line, run_sections

__all__ = [
    "PROXIMAL",
    "SECTIONS",
    "STIFF_PIN_FACTOR",
    "Outcome",
    "Pin",
    "ShakenVeraParameters",
    "choose",
    "cylindrical",
    "first_line",
    "printed_healthy",
    "render_thesis_page",
    "run_sections",
    "shaken_vera",
]
