"""Arms under test: their models, their linear response, how joints are braked or servoed.

Data flow: engine_warnings -> reach -> shaker -> packed_spec -> arm -> response -> spec_parts ->
holding -> library -> files.
"""

from loose_env.arms.arm import Arm, Gears, Holding, HoldKind
from loose_env.arms.engine_warnings import quiet
from loose_env.arms.files.load import (
    DESK_ARM,
    SERVO_ARM,
    SIX_AXIS_SERVO_ARM,
    arm_from_file,
    arm_of_model_file,
    describe_file,
    unfelt_words,
)
from loose_env.arms.files.model_reader import (
    ModelFile,
    compile_spec,
    load_spec,
    model_file,
    read_model_file,
    require_numbers,
)
from loose_env.arms.files.report import FileReport, report
from loose_env.arms.files.safe_scan import files_of
from loose_env.arms.files.serial_chain import Chain, find_chain
from loose_env.arms.holding.compliance import held, servoed, wind_up, with_compliance
from loose_env.arms.library.planar import planar
from loose_env.arms.library.puma560 import six_axis
from loose_env.arms.library.scara import scara
from loose_env.arms.library.vera import (
    BENDING_MODE_HZ,
    BLOCK_MASS,
    LINK2_MASS,
    LINK_LENGTH,
    BendingLink2,
    vera,
    vera_spec,
)
from loose_env.arms.response.linear import LinearArm, LinearPose, Response
from loose_env.arms.response.mismatch import Drift, Mismatch, MismatchDraw, MismatchIndices
from loose_env.arms.response.sensor_sites import LinkSite, Place, link_site
from loose_env.arms.response.shaken import ShakenArm
from loose_env.arms.response.stiffness import inertance_rate
from loose_env.arms.shaker import COIL, Shaker, add_shaker, place_shaker
from loose_env.arms.spec_parts import (
    CREST_FACTOR,
    FASTEST_TURN,
    GRAVITY,
    HOLDING_MODE_HZ,
    held_inertia,
    holdings,
    new_spec,
)

__all__ = [
    "BENDING_MODE_HZ",
    "BLOCK_MASS",
    "COIL",
    "CREST_FACTOR",
    "DESK_ARM",
    "FASTEST_TURN",
    "GRAVITY",
    "HOLDING_MODE_HZ",
    "LINK2_MASS",
    "LINK_LENGTH",
    "SERVO_ARM",
    "SIX_AXIS_SERVO_ARM",
    "Arm",
    "BendingLink2",
    "Chain",
    "Drift",
    "FileReport",
    "Gears",
    "HoldKind",
    "Holding",
    "LinearArm",
    "LinearPose",
    "LinkSite",
    "Mismatch",
    "MismatchDraw",
    "MismatchIndices",
    "ModelFile",
    "Place",
    "Response",
    "ShakenArm",
    "Shaker",
    "add_shaker",
    "arm_from_file",
    "arm_of_model_file",
    "compile_spec",
    "describe_file",
    "files_of",
    "find_chain",
    "held",
    "held_inertia",
    "holdings",
    "inertance_rate",
    "link_site",
    "load_spec",
    "model_file",
    "new_spec",
    "place_shaker",
    "planar",
    "quiet",
    "read_model_file",
    "report",
    "require_numbers",
    "scara",
    "servoed",
    "six_axis",
    "unfelt_words",
    "vera",
    "vera_spec",
    "wind_up",
    "with_compliance",
]
