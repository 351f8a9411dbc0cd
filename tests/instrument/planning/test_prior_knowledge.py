"""What a plan takes from a diagnosis: each fault's own direction, and that once."""

from __future__ import annotations

import json

import numpy as np
import pytest

from loose_env.arms import six_axis
from loose_env.instrument.planning.prior_knowledge import belief_of, known_of, names_of
from loose_env.instrument.result import Diagnosis, Fault, RecordSeen, SlideDirection
from loose_env.statistics import axes_grid

ARM = six_axis()
LINKS, JOINTS = tuple(ARM.seat_bodies), tuple(ARM.joints)
NAMES = names_of(LINKS, JOINTS)
POSE = {joint: 0.1 * k for k, joint in enumerate(JOINTS)}
GRID = axes_grid(60)


def diagnosis(records: int, **more: object) -> Diagnosis:
    posterior = dict.fromkeys(NAMES, 1 / len(NAMES))
    best = NAMES[2]
    seen = tuple(
        RecordSeen(
            file=f"run-{k}", pose=POSE, excited=JOINTS[:1], condition="suspect",
            probabilities=posterior, direction_tool=(0.6, 0.0, 0.8), half_angle_deg=15.0,
        )
        for k in range(records)
    )  # fmt: skip
    fault = Fault(kind="structural_looseness", where=best.partition("@")[2])
    return Diagnosis(
        fault=fault, probability=posterior[best], posterior=posterior, records=seen,
        **more,  # type: ignore[arg-type]
    )  # fmt: skip


def spread(found: Diagnosis) -> np.ndarray:
    """Probabilities of the directions within every link (n, A)."""
    belief = belief_of(known_of(found, LINKS, JOINTS), ARM, NAMES, LINKS, GRID, 1)
    loose = np.asarray(belief.loose)[0, : ARM.n * len(GRID), 0].reshape(ARM.n, -1)
    weight = np.exp(loose - loose.max(axis=1, keepdims=True))
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))


@pytest.mark.parametrize("own", [True, False])
def test_a_direction_that_all_runs_have_together_counts_once(own: bool) -> None:
    directions = {LINKS[1]: SlideDirection(axis=(0.6, 0.0, 0.8), half_angle_deg=15.0)}
    more = {"directions": directions} if own else {}
    np.testing.assert_allclose(spread(diagnosis(4, **more)), spread(diagnosis(1, **more)))


def test_every_link_has_the_direction_of_its_own_fit() -> None:
    axes = {LINKS[1]: (1.0, 0.0, 0.0), LINKS[4]: (0.0, 0.0, 1.0)}
    slides = {name: SlideDirection(axis=axis, half_angle_deg=10.0) for name, axis in axes.items()}
    found = spread(diagnosis(3, directions=slides))
    for k, link in enumerate(LINKS):
        if link in axes:
            best = GRID[int(np.argmax(found[k]))]
            assert abs(float(best @ np.array(axes[link]))) > 0.95
        else:
            assert found[k] == pytest.approx(1 / len(GRID))


def test_directions_read_back_as_they_were() -> None:
    slide = SlideDirection(axis=(0.6, 0.0, 0.8), half_angle_deg=10.0)
    whole = diagnosis(1, directions={LINKS[0]: slide})
    assert Diagnosis.from_json(whole.to_json()).directions == whole.directions
    plain = json.loads(whole.to_json())
    del plain["directions"]
    assert Diagnosis.from_json(json.dumps(plain)).directions == {}
