"""A bank of few candidates on two short motions, for tests."""

from functools import cache

from loose_env.arms import SERVO_ARM
from loose_env.gap import Motion, MotionBank, motion_bank, read_servo_arm

KINDS = ("coulomb_friction", "payload", "rotor_inertia")
LIBRARY = (
    Motion(kind="random", joints=(0, 1, 2), amplitude=0.4, speed=1.5, seconds=1.5, seed=3),
    Motion(kind="slow_triangle", joints=(1,), amplitude=0.1, speed=0.2, seconds=2.0),
)


@cache
def small_bank() -> MotionBank:
    """Candidates on both motions, sized on the first."""
    arm = read_servo_arm(SERVO_ARM)
    return motion_bank(arm, LIBRARY, KINDS, reference=LIBRARY[:1], cache=None)
