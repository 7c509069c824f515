from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from palletloc.face_view import view_face, visible_lines

from palletloc.face import EdgeKind, face_lines
from palletloc.geometry import LevelPose
from palletloc.measurement import Reason
from palletloc.pallet import PalletModel
from palletloc.plane import PlaneView
from palletloc.shot import Shot

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
FINEST = 0.003
Portrait = Callable[..., Shot]


def seen_at(shot: Shot, pose: LevelPose, model: PalletModel) -> PlaneView | Reason:
    return view_face(shot.projector, shot.image, shot.camera_from_forklift, pose, model, FINEST)


def test_the_view_is_the_face_and_a_margin_where_the_pose_is(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    view = seen_at(shot, POSE, t11)
    assert isinstance(view, PlaneView)
    grid = view.grid
    assert grid.left < -t11.width / 2
    assert -grid.left == pytest.approx(grid.left + (grid.columns - 1) * grid.resolution, abs=grid.resolution)
    assert grid.top > t11.height
    assert grid.top - (grid.rows - 1) * grid.resolution < 0.0
    assert view.valid.all()
    forklift_from_plane = shot.mounting.forklift_from_camera * view.camera_from_plane
    corners = [[right, up, 0.0] for right in (-t11.width / 2, t11.width / 2) for up in (0.0, t11.height)]
    in_pallet = [[0.0, -right, up] for right, up, _ in corners]
    expected = POSE.transform().apply(in_pallet)
    np.testing.assert_allclose(forklift_from_plane.apply(corners), expected, atol=1e-9)


def test_openings_are_darker_than_blocks_where_the_model_has_them(portrait: Portrait, epal: PalletModel) -> None:
    view = seen_at(portrait(epal, POSE), POSE, epal)
    assert isinstance(view, PlaneView)
    up = epal.openings[0].bottom + epal.openings[0].height / 2
    blocks = [(left + right) / 2 for left, right in epal.blocks]
    openings = [opening.center for opening in epal.openings]
    brightness = [
        view.image[row, column].mean()
        for column, row in np.rint(view.grid.pixels(np.array([[r, up] for r in blocks + openings]))).astype(int)
    ]
    assert max(brightness[len(blocks) :]) < min(brightness[: len(blocks)])


@pytest.mark.parametrize("up", [-1.0, 1.8])
def test_from_below_the_lower_edge_is_not_measured(up: float, open_below: PalletModel) -> None:
    kinds = {line.kind for line in visible_lines(open_below, np.array([0.0, up, 2.0]))}
    assert (EdgeKind.BOTTOM in kinds) is (up > 0)
    assert kinds | {EdgeKind.BOTTOM} == {line.kind for line in face_lines(open_below)}


def test_from_behind_there_is_no_face(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    turned = replace(POSE, yaw=POSE.yaw + np.pi)
    assert seen_at(shot, turned, t11) is Reason.BEHIND_FACE
    assert seen_at(shot, replace(POSE, x=0.3, y=0.0), t11) is Reason.BEHIND_FACE


@pytest.mark.parametrize("x", [-0.8, 2.6, 40.0])
def test_a_face_that_the_image_does_not_show_wholly_is_out_of_view(
    x: float, portrait: Portrait, t11: PalletModel
) -> None:
    assert seen_at(portrait(t11, POSE), replace(POSE, x=x), t11) is Reason.OUT_OF_VIEW
