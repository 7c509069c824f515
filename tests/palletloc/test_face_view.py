from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from palletloc.candidate import ShotView
from palletloc.face import EdgeKind, face_lines
from palletloc.face_view import FaceView, MeasuredEdge, measure_edges, view_face, visible_lines
from palletloc.geometry import LevelPose
from palletloc.measurement import Reason
from palletloc.pallet import PalletModel

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
FINEST = 0.003
Portrait = Callable[..., ShotView]


def seen_at(shot: ShotView, pose: LevelPose, model: PalletModel) -> FaceView | Reason:
    return view_face(shot.projector, shot.image, shot.camera_from_forklift, pose, model, FINEST)


def edges_at(shot: ShotView, pose: LevelPose, model: PalletModel) -> list[MeasuredEdge]:
    seen = seen_at(shot, pose, model)
    assert isinstance(seen, FaceView)
    return measure_edges(shot.projector, seen, model, 0.012, 0.02, 1.5)


def moved(pose: LevelPose, right: float, up: float) -> LevelPose:
    x, y = pose.x + right * np.sin(pose.yaw), pose.y - right * np.cos(pose.yaw)
    return replace(pose, x=x, y=y, z=pose.z + up)


def test_the_view_is_the_face_and_a_margin_and_knows_where_the_camera_is(
    portrait: Portrait, t11: PalletModel
) -> None:
    shot = portrait(t11, POSE)
    seen = seen_at(shot, POSE, t11)
    assert isinstance(seen, FaceView)
    assert seen.edges == ()
    grid = seen.view.grid
    assert grid.left < -t11.width / 2
    assert -grid.left == pytest.approx(grid.left + (grid.columns - 1) * grid.resolution, abs=grid.resolution)
    assert grid.top > t11.height
    plane_from_forklift = seen.view.camera_from_plane.inv() * shot.camera_from_forklift
    np.testing.assert_allclose(plane_from_forklift.apply(shot.mounting.center), seen.plane_from_camera, atol=1e-9)
    np.testing.assert_allclose(
        np.linalg.norm(seen.plane_from_camera), np.linalg.norm(shot.mounting.center - [POSE.x, POSE.y, POSE.z])
    )
    assert seen.plane_from_camera[2] > 0


@pytest.mark.parametrize("name", ["epal", "t11", "open_below"])
def test_edges_are_where_the_true_pose_says(name: str, portrait: Portrait, request: pytest.FixtureRequest) -> None:
    model: PalletModel = request.getfixturevalue(name)
    edges = edges_at(portrait(model, POSE), POSE, model)
    certain = [one for one in edges if one.edge.kind is not EdgeKind.TOP]  # a load stands on the upper edge
    offsets = np.array([one.fit.offset for one in certain])
    assert len(certain) >= 6
    assert np.median(np.abs(offsets)) < 0.003
    normalised = offsets / np.array([np.hypot(one.sigma, one.shift.sigma) for one in certain])
    assert np.mean(np.abs(normalised) < 3.0) > 0.7
    level = [one for one in certain if one.edge.horizontal and one.edge.length > 0.5]
    assert all(abs(one.fit.slope) < np.radians(1.0) for one in level)


@pytest.mark.parametrize(("right", "up"), [(0.005, 0.0), (0.0, -0.005), (-0.004, 0.004)])
def test_edges_move_against_the_pose(right: float, up: float, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    before = {one.edge: one for one in edges_at(shot, POSE, t11)}
    after = {one.edge: one for one in edges_at(shot, moved(POSE, right, up), t11)}
    common = [edge for edge in before if edge in after and before[edge].fit.coverage > 0.6]
    assert len(common) >= 6
    expected = np.array([-right * edge.outward[0] - up * edge.outward[1] for edge in common])
    found = np.array([after[edge].fit.offset - before[edge].fit.offset for edge in common])
    assert np.median(np.abs(found - expected)) < 0.0005
    assert np.mean(np.abs(found - expected) < 0.0015) > 0.7


def test_a_pixel_is_larger_where_the_face_is_seen_aslant(portrait: Portrait, t11: PalletModel) -> None:
    edges = edges_at(portrait(t11, POSE), POSE, t11)
    across = {one.edge.horizontal: one.pixel for one in edges}
    distance = float(np.hypot(POSE.x - 0.3, POSE.y + 0.08))
    straight = np.hypot(distance, 1.85) / 560.0
    assert across[False] > straight
    assert across[True] > straight  # seen from 40 degrees above


def test_the_upper_edge_may_be_loaded_from_above_and_not_from_below(t11: PalletModel, portrait: Portrait) -> None:
    above, high = portrait(t11, POSE), replace(POSE, z=2.6)
    below = portrait(t11, high)
    for shot, pose, loaded in ((above, POSE, True), (below, high, False)):
        seen = seen_at(shot, pose, t11)
        assert isinstance(seen, FaceView)
        kinds = {line.kind: seen.loaded(line.whole) for line in face_lines(t11)}
        assert kinds.pop(EdgeKind.TOP) is loaded
        assert not any(kinds.values())


@pytest.mark.parametrize("up", [-1.0, 1.8])
def test_from_below_the_lower_edge_is_not_measured(up: float, open_below: PalletModel) -> None:
    kinds = {line.kind for line in visible_lines(open_below, np.array([0.0, up, 2.0]))}
    assert (EdgeKind.BOTTOM in kinds) is (up > 0)
    assert kinds | {EdgeKind.BOTTOM} == {line.kind for line in face_lines(open_below)}


def test_it_expects_every_line_but_a_loaded_one(portrait: Portrait, t11: PalletModel) -> None:
    seen = seen_at(portrait(t11, POSE), POSE, t11)
    assert isinstance(seen, FaceView)
    assert seen.expected == len(face_lines(t11)) - 1


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


def test_a_plain_image_has_no_edges(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    plain = replace(shot, image=np.full_like(shot.image, 100))
    assert edges_at(plain, POSE, t11) == []
