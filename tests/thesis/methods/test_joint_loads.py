"""Joint loads: the closed form, MuJoCo's inverse dynamics and an independent derivation agree."""

from __future__ import annotations

import numpy as np
import pytest
from tests.faults.thesis_equations import Figures, healthy_torques, thesis_arm

from loose_env.arms import planar, vera
from loose_env.thesis import cylindrical
from loose_env.thesis.methods.motion.joint_loads import (
    TwoLinks,
    arm_loads,
    peak_force,
    two_link_loads,
)


@pytest.mark.parametrize("seed", range(4))
def test_three_derivations_agree(seed: int) -> None:
    rng = np.random.default_rng(seed)
    figures = Figures.draw(rng)
    arm = thesis_arm(figures)
    links = TwoLinks.of(arm)
    q, v, a = rng.uniform(-3, 3, (3, 2))
    closed = two_link_loads(links, q[1], v, a, gravity=0.0)
    simulated = arm_loads(arm, q, v, a)
    np.testing.assert_allclose(closed.torque, healthy_torques(figures, q, v, a), atol=1e-10)
    for name in ("torque", "force", "moment"):
        np.testing.assert_allclose(getattr(closed, name), getattr(simulated, name), atol=1e-9)


def test_vera_with_its_weight_and_rotors() -> None:
    arm = vera()
    links = TwoLinks.of(arm)
    rng = np.random.default_rng(1)
    for q, v, a in rng.uniform(-4, 4, (5, 3, 2)):
        closed, simulated = two_link_loads(links, q[1], v, a), arm_loads(arm, q, v, a)
        for name in ("torque", "force", "moment"):
            np.testing.assert_allclose(getattr(closed, name), getattr(simulated, name), atol=1e-9)


def test_the_printed_slips_would_show() -> None:
    """With m2 lc1² in place of m1 lc1² the torque would be another, wherever m1 is not m2."""
    links = TwoLinks(length=0.5, masses=(3.0, 1.0), centres=(0.3, 0.2), inertias=(0.1, 0.05))
    found = two_link_loads(links, 0.0, [0.0, 0.0], [1.0, 0.0]).torque[0]
    by_hand = 0.1 + 3.0 * 0.3**2 + 0.05 + 1.0 * 0.7**2
    assert found == pytest.approx(by_hand)
    assert found != pytest.approx(by_hand + (1.0 - 3.0) * 0.3**2)


def test_a_whirling_arm_pulls_its_joints_along_the_links() -> None:
    links = TwoLinks(length=0.5, masses=(3.0, 1.0), centres=(0.3, 0.2), inertias=(0.1, 0.05))
    force = two_link_loads(links, 0.0, [2.0, 0.0], [0.0, 0.0]).force
    np.testing.assert_allclose(force[:, 0], [-4 * (3 * 0.3 + 0.7), -4 * 0.7])
    np.testing.assert_allclose(force[:, 1], 0.0, atol=1e-12)


def test_a_hanging_arm_is_held_against_its_weight() -> None:
    """Planar arm in a vertical plane, stretched level: static moments by hand."""
    arm = planar(2, vertical=True)
    still = [0.0, 0.0]
    loads = arm_loads(arm, still, still, still)
    mass = arm.model.body_mass
    total = float(mass.sum())
    assert loads.force[0, 1] == pytest.approx(9.81 * total)
    outer = float(mass[arm.model.body("flange2").id] + mass[arm.model.body("link2").id])
    assert loads.force[1, 1] == pytest.approx(9.81 * outer)
    assert loads.torque[1] == pytest.approx(9.81 * mass[arm.model.body("link2").id] * 0.55 * 0.3)
    free = arm_loads(arm, still, still, still, gravity=False)
    np.testing.assert_allclose(free.force, 0.0, atol=1e-9)
    np.testing.assert_allclose(free.moment, 0.0, atol=1e-9)


def test_the_spatial_arm_carries_its_weight_on_the_lift() -> None:
    arm = cylindrical()
    pose = np.array([0.3, 0.4, 0.5, 0.1, 0.2, -0.1])
    loads = arm_loads(arm, pose, np.zeros(6), np.zeros(6))
    model = arm.model
    lifted = model.body_subtreemass[model.jnt_bodyid[model.joint("joint2").id]]
    assert loads.torque[1] == pytest.approx(-float(model.opt.gravity[2]) * float(lifted))


def test_the_sweep_broadcasts() -> None:
    links = TwoLinks.of(vera())
    angles = np.linspace(-1, 1, 5)[:, None]
    rates = np.stack(np.broadcast_arrays(1.0, np.linspace(-2, 2, 3)[None]), axis=-1)
    loads = two_link_loads(links, angles, rates, [1.0, 0.0])
    assert loads.torque.shape == (5, 3, 2) and loads.force.shape == (5, 3, 2, 3)
    one = two_link_loads(links, angles[4, 0], rates[0, 2], [1.0, 0.0])
    np.testing.assert_allclose(loads.moment[4, 2], one.moment)


def test_the_peak_says_where_and_which_way() -> None:
    force = np.array([[[1.0, 0.0, 9.0], [-3.0, 4.0, 9.0]], [[0.0, 0.0, 9.0], [2.0, 2.0, 9.0]]])
    peak = peak_force(force, [np.array([[10.0], [20.0]]), np.array([[1.0, 2.0]])])
    assert (peak.size, peak.along, peak.across) == (5.0, -3.0, 4.0)
    assert peak.at == (10.0, 2.0) and peak.direction == "tangential"
