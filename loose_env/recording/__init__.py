"""The shared format of measured and simulated data: read, check, write."""

from loose_env.recording.joint_sensors import JointSensors, check_comparison, joint_sensors
from loose_env.recording.recording import Recording, read_recording
from loose_env.recording.run import Comparison, Condition, Run
from loose_env.recording.writing import FileFormat, write_recording

__all__ = [
    "Comparison",
    "Condition",
    "FileFormat",
    "JointSensors",
    "Recording",
    "Run",
    "check_comparison",
    "joint_sensors",
    "read_recording",
    "write_recording",
]
