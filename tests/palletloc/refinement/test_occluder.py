from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.cameras import Pinhole
from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.pallet import PalletModel
from palletloc.plane import PALLET_FROM_VERTICAL
from palletloc.projection import Projector
from palletloc.refinement.occlusion import posts, seen_before
from palletloc.refinement.patch import FacePatch, view_patch

CAMERA = Pinhole(640, 480, 380.0, 380.0, 319.5, 239.5)
MOUNTED = RigidTransform.from_components([0.3, -0.1, 1.0], Rotation.from_euler("ZYX", [1.2, 0.25, 0.02]))
POSE = LevelPose(0.9, 2.2, 0.3, 1.4)
FACE, FLOOR, GRAIN = 170.0, 90.0, 6.0
Paints = Callable[..., Image]


def seen(paint_plane: Paints, before: dict[tuple[float, float, float], float], aside: float = 0.0) -> FacePatch:
    """Return a view of a face 1.2 m wide with things before it: (left, right, lowest) and their gray."""

    def paint(points: FloatArray) -> FloatArray:
        right, up = points[..., 0], points[..., 1]
        gray = np.where((np.abs(right - aside) < 0.6) & (up > 0) & (up < 0.144), FACE, FLOOR)
        for (left, end, low), colour in before.items():
            gray = np.where((right > left) & (right < end) & (up > low), colour, gray)
        return gray

    camera_from_plane = (MOUNTED.inv() * POSE.transform() * PALLET_FROM_VERTICAL).as_matrix()
    image = paint_plane(CAMERA, camera_from_plane, (-1.3, 1.3, -0.2, 0.3), paint)
    noisy = image + np.random.default_rng(3).normal(0.0, GRAIN, image.shape)
    shot = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    patch = view_patch(Projector(CAMERA), shot, MOUNTED.inv(), POSE, (-0.75, 0.75, -0.1, 0.25), 0.006)
    assert isinstance(patch, FacePatch)
    return patch


@pytest.mark.parametrize("gray", [20.0, 160.0, 230.0])
@pytest.mark.parametrize(("left", "right"), [(-0.6, -0.35), (-0.1, 0.1), (0.2, 0.6)])
def test_a_post_that_reaches_below_the_face_is_seen(
    paint_plane: Paints, epal: PalletModel, left: float, right: float, gray: float
) -> None:
    patch = seen(paint_plane, {(left, right, -1.0): gray})
    assert seen_before(patch, epal, POSE, [(left, right)]) == pytest.approx((right - left) / epal.width)


def test_where_the_floor_goes_on_nothing_is_seen(paint_plane: Paints, epal: PalletModel) -> None:
    beside = seen(paint_plane, {}, aside=0.5)  # the real face stands half a metre aside: floor is where it should be
    assert seen_before(beside, epal, POSE, [(-0.6, -0.1)]) == 0.0
    above = seen(paint_plane, {(0.1, 0.4, 0.02): 20.0})
    assert seen_before(above, epal, POSE, [(0.1, 0.4)]) == 0.0


def test_each_hidden_stretch_is_judged_by_itself(paint_plane: Paints, epal: PalletModel) -> None:
    patch = seen(paint_plane, {(-0.4, -0.2, -1.0): 230.0})
    found = seen_before(patch, epal, POSE, [(-0.4, -0.2), (0.3, 0.6)])
    assert found == pytest.approx(0.2 / epal.width)


def test_nothing_is_explained_where_nothing_is_hidden_or_nothing_is_left(
    paint_plane: Paints, epal: PalletModel
) -> None:
    patch = seen(paint_plane, {(-0.4, -0.2, -1.0): 230.0})
    assert seen_before(patch, epal, POSE, []) == 0.0
    assert seen_before(patch, epal, POSE, [(-0.6, 0.6)]) == 0.0
    lifted = LevelPose(POSE.x, POSE.y, POSE.z - 0.3, POSE.yaw)  # what is below the face is out of the view
    assert seen_before(patch, epal, lifted, [(-0.4, -0.2)]) == 0.0


@pytest.mark.parametrize("gray", [20.0, 230.0])
@pytest.mark.parametrize(("left", "right"), [(-0.6, -0.5), (0.3, 0.36), (0.5, 0.6)])
def test_a_post_before_a_face_is_seen_where_it_stands(
    paint_plane: Paints, epal: PalletModel, left: float, right: float, gray: float
) -> None:
    ((low, high),) = posts(seen(paint_plane, {(left, right, -1.0): gray}), epal, POSE)
    assert low == pytest.approx(left, abs=0.025)
    assert high == pytest.approx(right, abs=0.025)


def test_what_is_only_on_the_face_or_only_below_it_is_no_post(paint_plane: Paints, epal: PalletModel) -> None:
    label = seen(paint_plane, {(-0.2, 0.1, 0.02): 20.0})
    assert posts(label, epal, POSE) == ()
    line = seen(paint_plane, {(-0.2, 0.1, -1.0): 20.0, (-0.25, 0.15, 0.0): FACE})
    assert posts(line, epal, POSE) == ()
    lifted = LevelPose(POSE.x, POSE.y, POSE.z - 0.3, POSE.yaw)
    assert posts(label, epal, lifted) == ()
