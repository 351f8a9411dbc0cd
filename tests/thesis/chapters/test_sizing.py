"""The sizing section: what it prints and what it finds."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import vera
from loose_env.thesis.ch6_experiments.arm.sizing import demand, section
from loose_env.thesis.methods.motion.joint_loads import TwoLinks
from loose_env.thesis.printed import printed
from loose_env.thesis.shared.sections import Section


@pytest.fixture(scope="module")
def found() -> Section:
    return section(0)


def test_the_section_is_complete(found: Section) -> None:
    assert found.key == "sizing" and len(found.cards) == 2 and len(found.tables) == 4
    assert {"3.41", "6.1", "6.2", "6.3", "6.4", "6.5", "6.6", "6.11", "6.12"} == set(
        found.equations
    )


def test_the_frequencies_stand_beside_the_printed_ones(found: Section) -> None:
    rows = {row[0]: row[1:] for row in found.tables[3].rows}
    assert rows["link 1, first bending mode [Hz] (6.6)"] == ("83", "82.6")
    assert rows["stinger [Hz] (6.11, 6.12), area in square inches"] == ("—", "885")
    assert float(rows["link 2, first bending mode [Hz] (6.6)"][1]) > 200


def test_the_tip_tells_which_joint_accelerates(found: Section) -> None:
    tips = [float(row[1]) for row in found.tables[1].rows]
    assert tips == [8.0, 8.4, 4.0]
    assert any("so joint 1 is meant" in words for words in found.words)


def test_the_peak_is_bent_and_fast() -> None:
    told = printed("sizing")
    angles, rates, loads = demand(TwoLinks.of(vera()), told, 5.0, (10.0, 0.0))
    size = np.abs(loads.torque[..., 0])
    i, j = np.unravel_index(int(size.argmax()), size.shape)
    assert abs(np.degrees(angles[i, 0])) > 45 and abs(rates[0, j]) == pytest.approx(5.0)
    # Joint 2's torque does not depend on its own rate.
    np.testing.assert_allclose(loads.torque[:, 0, 1], loads.torque[:, -1, 1], atol=1e-12)
