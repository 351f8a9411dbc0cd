"""A looseness joint in a chain: its column, and the columns that its displacement changes."""

import numpy as np
import pytest

from loose_env.arms import planar
from loose_env.errors import InvalidData, UnknownName
from loose_env.kinematics import Chain, geometric_jacobian
from loose_env.thesis.methods.looseness.looseness_joint import (
    changed_columns,
    displaced,
    insert_looseness,
    link_of_changed_columns,
    looseness_transform,
    slot_direction,
    velocity_error,
)
from tests.kinematics.test_chain import chain_of, spatial


def test_the_inserted_column_is_the_derivative_by_the_seat():
    _, data = spatial()
    chain, axis, step = chain_of(data), np.array([0.3, -0.5, 0.8]), 1e-6
    for kind in ("prismatic", "revolute"):
        column = geometric_jacobian(insert_looseness(chain, 2, axis, kind=kind))[:3, 2]
        ends = [displaced(chain, 2, axis, s * step, kind=kind).tool for s in (1, -1)]
        np.testing.assert_allclose(column, (ends[0] - ends[1]) / (2 * step), atol=1e-8)


def test_which_columns_change_depends_on_the_point_and_names_the_link():
    arm = planar(4)
    chain = Chain.of(arm, [0.2, 0.5, -0.8, 0.6])
    for link in range(1, 5):
        loose = displaced(chain, link, [1, 2, 0], 2e-4)
        for frame in ("tool", "world", "base"):
            changed = changed_columns(
                geometric_jacobian(chain, frame), geometric_jacobian(loose, frame), tolerance=1e-9
            )
            proximal = np.arange(1, 5) <= link
            assert changed.tolist() == (~proximal if frame == "base" else proximal).tolist()
            found = link_of_changed_columns(changed, frame)
            assert found == (0 if frame == "base" and link == 4 else link)


def test_a_hinge_leaves_the_distal_columns_only_in_tool_coordinates():
    chain = Chain.of(planar(3), [0.2, 0.5, -0.8])
    loose = displaced(chain, 2, [0, 0, 1], 1e-3, kind="revolute")
    for frame, expected in (("tool", [True, False, False]), ("world", [True, True, True])):
        changed = changed_columns(
            geometric_jacobian(chain, frame), geometric_jacobian(loose, frame), tolerance=1e-9
        )
        # Column 2 is that of the hinge itself, on the same axis: in tool axes it stays too.
        assert changed.tolist() == expected


def test_a_slide_adds_a_rank_and_play_does_not():
    chain = Chain.of(planar(2), [0.3, 0.9])
    rank = np.linalg.matrix_rank
    assert rank(geometric_jacobian(chain)) == 2
    assert rank(geometric_jacobian(insert_looseness(chain, 2, [1, 0, 0]))) == 3
    play = insert_looseness(chain, 2, [0, 0, 1], kind="revolute")
    assert rank(geometric_jacobian(play)) == 2


def test_the_velocity_error_is_the_seats_motion():
    chain = Chain.of(planar(3), [0.3, 0.9, 0.1])
    loose = insert_looseness(chain, 1, [0, 1, 0])
    error = velocity_error(
        geometric_jacobian(chain), [1, 2, 3], geometric_jacobian(loose), [1, 0.05, 2, 3]
    )
    np.testing.assert_allclose(error, [0, 0.05, 0, 0, 0, 0], atol=1e-15)


def test_the_looseness_transform_leaves_the_neighbours_parameters():
    def dh(a: float, alpha: float, d: float, theta: float) -> np.ndarray:
        ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)
        return np.array(
            [
                [ct, -st * ca, st * sa, a * ct],
                [st, ct * ca, -ct * sa, a * st],
                [0, sa, ca, d],
                [0, 0, 0, 1],
            ]
        )

    first, second = dh(0.4, 0.3, 0.1, 0.7), dh(0.2, -1.1, 0.0, 0.4)
    direction = slot_direction([0, 0, 1], [np.cos(0.6), np.sin(0.6), 0])
    np.testing.assert_allclose(direction, [-np.sin(0.6), np.cos(0.6), 0], atol=1e-15)
    at_rest = first @ looseness_transform(direction, 0.0) @ second
    np.testing.assert_allclose(at_rest, first @ second, atol=1e-14)
    moved = first @ looseness_transform(direction, 0.01) @ second
    np.testing.assert_allclose(moved[:3, :3], (first @ second)[:3, :3], atol=1e-14)
    np.testing.assert_allclose(
        moved[:3, 3] - at_rest[:3, 3], 0.01 * first[:3, :3] @ direction, atol=1e-14
    )


def test_bad_input_is_refused():
    with pytest.raises(UnknownName, match="links 1 to 2"):
        insert_looseness(Chain.of(planar(2), [0.0, 0.1]), 3, [1, 0, 0])
    with pytest.raises(InvalidData, match="one block"):
        link_of_changed_columns([False, True], "tool")
    with pytest.raises(InvalidData, match="perpendicular"):
        slot_direction([0, 0, 1], [1, 0, 1])
