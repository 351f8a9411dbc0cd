"""The diagnosis environments.

Data flow: faults -> settings -> episode -> rendering -> diagnosis_env ->
vector_inputs -> vector_env -> sb3 -> model_gap.
"""

from loose_env.envs.diagnosis_env import DiagnosisEnv, EnvState
from loose_env.envs.episode.actions import Action, ActionLayout
from loose_env.envs.episode.batch import BatchRig, EpisodeBatch
from loose_env.envs.episode.elements import Element
from loose_env.envs.episode.observation import ObservationLayout
from loose_env.envs.episode.state import Outcome
from loose_env.envs.faults.difficulty import DIFFICULTIES, Difficulty, difficulty_named
from loose_env.envs.faults.sampler import FaultSampler
from loose_env.envs.model_gap.env import ModelGapEnv
from loose_env.envs.model_gap.hidden_machine import HiddenEffect, HiddenMachine, MachineDraw
from loose_env.envs.model_gap.make import make_model_gap
from loose_env.envs.model_gap.observation import GapObservation
from loose_env.envs.model_gap.settings import GapPrices, ModelGapSettings
from loose_env.envs.rendering import palette
from loose_env.envs.rendering.correlation import Loop, measured_loop, predicted_loop
from loose_env.envs.rendering.fault_text import fault_words, hypothesis_words
from loose_env.envs.rendering.palette import EDGE, FAINT, INK, MEASURED, MUTED, PAPER, SHAKEN, TRUTH
from loose_env.envs.rendering.picture import Picture
from loose_env.envs.rendering.planar.arm import ArmDrawing
from loose_env.envs.rendering.planar.view import PlanarView, moves_in_a_plane
from loose_env.envs.rendering.scenery import arrow, draw_base, draw_measure, half_height
from loose_env.envs.rendering.spatial.arm import SpaceDrawing
from loose_env.envs.rendering.spatial.view import SpaceView
from loose_env.envs.settings import DiagnosisSettings, Prices
from loose_env.envs.vector_env import DiagnosisVectorEnv, VectorState
from loose_env.envs.vector_inputs import batch_seeds

__all__ = [
    "DIFFICULTIES",
    "EDGE",
    "FAINT",
    "INK",
    "MEASURED",
    "MUTED",
    "PAPER",
    "SHAKEN",
    "TRUTH",
    "Action",
    "ActionLayout",
    "ArmDrawing",
    "BatchRig",
    "DiagnosisEnv",
    "DiagnosisSettings",
    "DiagnosisVectorEnv",
    "Difficulty",
    "Element",
    "EnvState",
    "EpisodeBatch",
    "FaultSampler",
    "GapObservation",
    "GapPrices",
    "HiddenEffect",
    "HiddenMachine",
    "Loop",
    "MachineDraw",
    "ModelGapEnv",
    "ModelGapSettings",
    "ObservationLayout",
    "Outcome",
    "Picture",
    "PlanarView",
    "Prices",
    "SpaceDrawing",
    "SpaceView",
    "VectorState",
    "arrow",
    "batch_seeds",
    "difficulty_named",
    "draw_base",
    "draw_measure",
    "fault_words",
    "half_height",
    "hypothesis_words",
    "make_model_gap",
    "measured_loop",
    "moves_in_a_plane",
    "palette",
    "predicted_loop",
]
