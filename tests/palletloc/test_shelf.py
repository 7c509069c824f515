from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc.geometry import LevelPose, level_pose, wrap_angle
from palletloc.shelf import ShelfPlane

metres = st.floats(-20.0, 20.0)
angles = st.floats(-3.1, 3.1)
shelves = st.builds(ShelfPlane, metres, metres, angles)
forklifts = st.builds(LevelPose, metres, metres, st.just(0.0), angles)


def normal(shelf: ShelfPlane) -> np.ndarray:
    return np.array([np.cos(shelf.facing), np.sin(shelf.facing), 0.0])


@given(shelves, forklifts)
def test_the_seen_plane_is_the_same_plane(shelf: ShelfPlane, odom_from_forklift: LevelPose) -> None:
    seen = shelf.seen_from(odom_from_forklift)
    transform = odom_from_forklift.transform()
    point = transform.apply(np.array([seen.x, seen.y, 0.0]))
    np.testing.assert_allclose(point, [shelf.x, shelf.y, 0.0], atol=1e-9)
    np.testing.assert_allclose(transform.rotation.apply(normal(seen)), normal(shelf), atol=1e-9)


@given(shelves)
def test_from_the_origin_the_plane_is_as_given(shelf: ShelfPlane) -> None:
    seen = shelf.seen_from(LevelPose(0.0, 0.0, 0.0, 0.0))
    assert (seen.x, seen.y) == (shelf.x, shelf.y)
    assert seen.facing == pytest.approx(shelf.facing)


@given(shelves, forklifts, forklifts)
def test_going_on_is_the_same_as_going_at_once(shelf: ShelfPlane, first: LevelPose, second: LevelPose) -> None:
    at_once = shelf.seen_from(level_pose(first.transform() * second.transform()))
    in_turn = shelf.seen_from(first).seen_from(second)
    np.testing.assert_allclose([in_turn.x, in_turn.y], [at_once.x, at_once.y], atol=1e-8)
    assert wrap_angle(in_turn.facing - at_once.facing) == pytest.approx(0.0, abs=1e-9)


@given(shelves)
def test_a_straight_pallet_looks_into_the_shelf(shelf: ShelfPlane) -> None:
    assert -np.pi <= shelf.yaw < np.pi
    assert wrap_angle(shelf.yaw - shelf.facing - np.pi) == pytest.approx(0.0, abs=1e-9)


def test_levels_stay_and_the_drift_is_what_is_said() -> None:
    shelf = ShelfPlane(1.0, 2.0, -1.5, (0.0, 1.55), drift=0.5)
    moved = LevelPose(1.0, 0.0, 0.0, 0.2)
    assert shelf.seen_from(moved).levels == (0.0, 1.55)
    assert shelf.seen_from(moved).drift == 0.0
    assert shelf.seen_from(moved, drift=0.03).drift == 0.03
