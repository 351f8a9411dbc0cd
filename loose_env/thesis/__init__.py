"""The thesis's chapters, computed and set beside the printed results.

Data flow: methods -> printed -> rigs -> shared -> ch3_modelling -> ch5_simulation ->
ch6_experiments -> ch4_diagnosis.
"""

from loose_env.thesis.ch6_experiments.shaken_vera.cases import printed_healthy
from loose_env.thesis.methods.looseness.docked_arm import (
    DockedMotion,
    DockedVerdict,
    JigSettings,
    SeatMotion,
    docked_verdict,
    measure_docked,
    seat_motion,
)
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
    "DockedMotion",
    "DockedVerdict",
    "JigSettings",
    "Outcome",
    "Pin",
    "SeatMotion",
    "ShakenVeraParameters",
    "choose",
    "cylindrical",
    "docked_verdict",
    "first_line",
    "measure_docked",
    "printed_healthy",
    "render_thesis_page",
    "run_sections",
    "seat_motion",
    "shaken_vera",
]
