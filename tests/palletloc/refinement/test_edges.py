from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.cameras import Equirectangular, Pinhole
from palletloc.face import EdgeKind, face_lines
from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.plane import PALLET_FROM_VERTICAL
from palletloc.refinement.edges import BORDERING, EdgeReach, MeasuredEdge, SeenFace, measure_face
from palletloc.shot import Shot

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
REACH = EdgeReach(0.012, 0.012, 1.5)
Portrait = Callable[..., Shot]


def placed(mounting: Mounting, pose: LevelPose) -> tuple[FloatArray, FloatArray]:
    """The face's plane in the camera, and the camera's centre in the face's coordinates."""
    camera_from_face = (mounting.forklift_from_camera.inv() * pose.transform() * PALLET_FROM_VERTICAL).as_matrix()
    return camera_from_face, -camera_from_face[:3, :3].T @ camera_from_face[:3, 3]


def seen_at(shot: Shot, pose: LevelPose, model: PalletModel, reach: EdgeReach = REACH) -> SeenFace | None:
    return measure_face(shot.camera, shot.image, *placed(shot.mounting, pose), model, reach)


def edges_at(shot: Shot, pose: LevelPose, model: PalletModel) -> tuple[MeasuredEdge, ...]:
    seen = seen_at(shot, pose, model)
    assert seen is not None
    return seen.edges


def moved(pose: LevelPose, right: float, up: float) -> LevelPose:
    x, y = pose.x + right * np.sin(pose.yaw), pose.y - right * np.cos(pose.yaw)
    return replace(pose, x=x, y=y, z=pose.z + up)


def test_a_face_knows_where_the_camera_is(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    seen = seen_at(shot, POSE, t11)
    assert seen is not None
    forklift_from_face = POSE.transform() * PALLET_FROM_VERTICAL
    np.testing.assert_allclose(forklift_from_face.apply(seen.plane_from_camera), shot.mounting.center, atol=1e-9)
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
    assert all(abs(one.fit.slope) < np.radians(1.25) for one in level)


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


def test_a_face_is_as_wide_as_its_ends_are_apart_in_the_image(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    seen = seen_at(shot, POSE, t11)
    assert seen is not None
    ends = POSE.transform().apply([[0.0, side * t11.width / 2, t11.height / 2] for side in (-1, 1)])
    pixels = shot.camera.project(shot.mounting.to_camera.apply(ends)).pixels
    assert seen.width_px(t11.width) == pytest.approx(float(np.linalg.norm(pixels[1] - pixels[0])), rel=0.03)
    assert replace(seen, edges=()).width_px(t11.width) == 0.0


def test_the_upper_edge_may_be_loaded_from_above_and_not_from_below(t11: PalletModel, portrait: Portrait) -> None:
    above, high = portrait(t11, POSE), replace(POSE, z=2.6)
    below = portrait(t11, high)
    for shot, pose, loaded in ((above, POSE, True), (below, high, False)):
        seen = seen_at(shot, pose, t11)
        assert seen is not None
        kinds = {line.kind: seen.loaded(line.whole) for line in face_lines(t11)}
        assert kinds.pop(EdgeKind.TOP) is loaded
        assert not any(kinds.values())


def test_from_below_the_lower_edge_is_not_measured(portrait: Portrait, t11: PalletModel) -> None:
    high = replace(POSE, z=2.6)
    seen = seen_at(portrait(t11, high), high, t11)
    assert seen is not None
    assert EdgeKind.BOTTOM not in {one.edge.kind for one in seen.edges}
    lines = [line.whole for line in face_lines(t11) if line.kind != EdgeKind.BOTTOM]
    assert seen.expected == pytest.approx(sum(seen.says(line) for line in lines))


def test_it_expects_every_line_but_a_loaded_one(portrait: Portrait, t11: PalletModel) -> None:
    seen = seen_at(portrait(t11, POSE), POSE, t11)
    assert seen is not None
    assert seen.expected == pytest.approx(len(face_lines(t11)) - 1 - (1 - BORDERING))


@pytest.mark.parametrize(("aside", "bordering"), [(-1.5, "left"), (0.0, None), (0.5, None), (1.5, "right")])
def test_a_pallets_own_side_begins_at_the_edge_towards_who_stands_aside(
    portrait: Portrait, t11: PalletModel, aside: float, bordering: str | None
) -> None:
    seen = seen_at(portrait(t11, POSE), POSE, t11)
    assert seen is not None
    beside = replace(seen, plane_from_camera=np.array([aside, 1.0, 2.0]))
    left, right = (line.whole for line in face_lines(t11) if line.kind is EdgeKind.SIDE)
    assert [beside.borders_on_side(edge) for edge in (left, right)] == [bordering == "left", bordering == "right"]
    assert {beside.says(left), beside.says(right)} == ({1.0} if bordering is None else {1.0, BORDERING})


@pytest.mark.parametrize("x", [-0.8, 2.6, 40.0])
def test_a_face_cut_by_the_border_is_not_measured(x: float, portrait: Portrait, t11: PalletModel) -> None:
    assert seen_at(portrait(t11, POSE), replace(POSE, x=x), t11) is None


@pytest.mark.parametrize("grown", [0.0023, -0.0037])
@pytest.mark.parametrize("name", ["epal", "t11", "open_below"])
def test_drawn_edges_are_measured_to_a_tenth_of_a_pixel(
    name: str, grown: float, shoot_face: Callable[..., Image], request: pytest.FixtureRequest
) -> None:
    model: PalletModel = request.getfixturevalue(name)
    sharp = replace(model, edge_radius=0.0)
    camera = Pinhole(900, 320, 900.0, 900.0, 449.5, 159.5)
    turned = Rotation.from_euler("ZYX", [1.25, 0.42, 0.03])
    mounting = Mounting(RigidTransform.from_components([0.3, 0.1, 1.1], turned))
    pose = LevelPose(0.9, 2.1, 0.0, np.pi / 2 - 0.15)
    camera_from_face, center = placed(mounting, pose)
    image = shoot_face(camera, camera_from_face, sharp, grown)
    seen = measure_face(camera, image, camera_from_face, center, sharp, EdgeReach(0.011, 0.011, 1.5))
    assert seen is not None
    assert len(seen.edges) == len(face_lines(model))
    for one in seen.edges:
        assert one.fit.coverage > 0.9
        assert one.fit.offset == pytest.approx(grown, abs=0.1 * one.pixel)
        assert abs(one.fit.slope) * one.edge.length < 0.2 * one.pixel


@pytest.mark.parametrize("columns", [0, 1, 480, 951])
def test_a_face_across_the_seam_of_a_closed_image_is_measured_like_any_other(
    columns: int, shoot_face: Callable[..., Image], t11: PalletModel
) -> None:
    camera, sharp = Equirectangular(1600, 800), replace(t11, edge_radius=0.0)
    tilted = Rotation.from_euler("ZYX", [0.0, 0.02, 0.01])
    mounting = Mounting(RigidTransform.from_components([0.0, 0.0, 0.9], tilted))
    pose = LevelPose(1.5, 0.1, 0.0, 0.1)
    camera_from_face, center = placed(mounting, pose)
    image = shoot_face(camera, camera_from_face, sharp)
    shift = camera.width // 2 + columns  # the face lies in the middle of the image
    turn = LevelPose(0.0, 0.0, 0.0, 2 * np.pi * shift / camera.width).transform()
    turned = Mounting(mounting.forklift_from_camera * turn)
    straight, across = (
        measure_face(camera, picture, *placed(where, pose), sharp, REACH)
        for picture, where in ((image, mounting), (np.roll(image, shift, axis=1), turned))
    )
    assert straight is not None
    assert across is not None
    assert len(straight.edges) == len(across.edges) == len(face_lines(t11))
    for one, other in zip(straight.edges, across.edges, strict=True):
        assert other.edge == one.edge
        assert other.fit.offset == pytest.approx(one.fit.offset, abs=0.01 * one.pixel)
        assert other.pixel == pytest.approx(one.pixel, rel=1e-6)
    np.testing.assert_allclose(across.plane_from_camera, center, atol=1e-9)


def test_colour_and_gray_agree(portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    gray = replace(shot, image=np.asarray(shot.image.mean(axis=2), dtype=np.uint8))
    same = replace(shot, image=np.repeat(gray.image[..., None], 3, axis=2))
    one, other = edges_at(gray, POSE, epal), edges_at(same, POSE, epal)
    assert [edge.edge for edge in one] == [edge.edge for edge in other]
    np.testing.assert_allclose([e.fit.offset for e in one], [e.fit.offset for e in other], atol=1e-6)


def test_a_plain_image_has_no_edges(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    plain = replace(shot, image=np.full_like(shot.image, 100))
    assert edges_at(plain, POSE, t11) == ()
