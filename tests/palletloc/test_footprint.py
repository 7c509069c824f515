from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from palletloc.footprint import outline, overlapping, overlaps
from palletloc.geometry import LevelPose, level_pose
from palletloc.pallet import Opening, PalletModel

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
WIDE = PalletModel("wide", 1.2, 0.144, 0.8, (Opening(0.0, 0.02, 0.4, 0.1),))
NARROW = PalletModel("narrow", 0.8, 0.144, 1.2, (Opening(0.0, 0.02, 0.4, 0.1),))

metres, angles = st.floats(-20.0, 20.0), st.floats(-3.1, 3.1)
places = st.builds(LevelPose, metres, metres, st.floats(0.0, 5.0), angles)


def beside(pose: LevelPose, into: float, left: float, up: float = 0.0, turn: float = 0.0) -> LevelPose:
    """A pose given in the frame of another."""
    return level_pose(pose.transform() * LevelPose(into, left, up, turn).transform())


@given(places)
def test_a_pallet_overlaps_itself_and_none_far_away(pose: LevelPose) -> None:
    assert overlapping(pose, WIDE, pose, WIDE)
    assert overlapping(pose, WIDE, pose, NARROW)
    for place in (
        beside(pose, 0.0, 1.3),
        beside(pose, 0.0, -1.3),
        beside(pose, 1.3, 0.0),
        beside(pose, 0.0, 0.0, 1.0),
    ):
        assert not overlapping(pose, WIDE, place, WIDE)


@given(places, st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(-0.3, 0.3))
def test_overlap_is_mutual_and_does_not_depend_on_the_frame(
    pose: LevelPose, into: float, left: float, up: float
) -> None:
    other = beside(pose, into, left, up)
    found = overlapping(pose, WIDE, other, NARROW)
    assert overlapping(other, NARROW, pose, WIDE) == found
    origin = LevelPose(0.0, 0.0, 0.0, 0.0)
    margins = [abs(left) - 0.92, abs(up) - 0.144, abs(into) - 0.8]
    if min(abs(margin) for margin in margins) > 1e-6:
        assert overlapping(origin, WIDE, LevelPose(into, left, up, 0.0), NARROW) == found


def test_neighbours_that_touch_and_pallets_on_each_other_do_not_overlap() -> None:
    assert not overlapping(POSE, WIDE, beside(POSE, 0.0, 1.19), WIDE)
    assert not overlapping(POSE, WIDE, beside(POSE, 0.0, 0.0, 0.144), WIDE)
    assert overlapping(POSE, WIDE, beside(POSE, 0.0, 0.5), WIDE)  # shifted by one opening
    assert overlapping(POSE, WIDE, beside(POSE, 0.1, 0.1, 0.03, 0.05), WIDE)


@given(st.lists(places, min_size=1, max_size=4), st.lists(places, min_size=1, max_size=4))
def test_many_at_once_are_each_told_as_two_of_them(ones: list[LevelPose], others: list[LevelPose]) -> None:
    near = [*others, *(beside(pose, 0.1, 0.2) for pose in ones)]
    poses, there = (np.array([pose.as_array() for pose in some]) for some in (ones, near))
    found = overlaps(poses[:, None], outline(WIDE), there, outline(NARROW))
    assert found.tolist() == [[overlapping(pose, WIDE, other, NARROW) for other in near] for pose in ones]
