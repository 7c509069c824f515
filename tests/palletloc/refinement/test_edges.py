from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc import LevelPose, Mounting, PalletModel, Shot
from palletloc.cameras import CameraModel, Equirectangular, Pinhole
from palletloc.face import EdgeKind, face_lines
from palletloc.measurement import Reason
from palletloc.refinement.edges import BORDERING, EdgeReach, MeasuredEdge, SeenFace, measure_face
from tests.palletloc.poses import POSE, Portrait, Shoots, blanked, moved

REACH = EdgeReach(0.012, 0.012, 1.5)


def seen_at(shot: Shot, pose: LevelPose, model: PalletModel, reach: EdgeReach = REACH) -> SeenFace:
    found = measure_face(shot, pose, model, reach)
    assert isinstance(found, SeenFace)
    return found


def edges_at(shot: Shot, pose: LevelPose, model: PalletModel) -> tuple[MeasuredEdge, ...]:
    return seen_at(shot, pose, model).edges


def blank(camera: CameraModel, mounting: Mounting) -> Shot:
    return Shot(np.zeros((camera.height, camera.width), np.uint8), camera, mounting)


def test_a_face_knows_where_the_camera_is(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    seen = seen_at(shot, POSE, t11)
    np.testing.assert_array_equal(seen.plane_from_camera, shot.camera_in(POSE))
    np.testing.assert_array_equal(seen.camera_from_face, shot.camera_from_face(POSE))
    assert seen.plane_from_camera[2] > 0


def test_edges_are_where_the_true_pose_says(model: PalletModel, portrait: Portrait) -> None:
    edges = edges_at(portrait(model, POSE), POSE, model)
    certain = [
        measured for measured in edges if measured.edge.kind is not EdgeKind.TOP
    ]  # a load stands on the upper edge
    offsets = np.array([measured.fit.offset for measured in certain])
    assert len(certain) >= 6
    assert np.median(np.abs(offsets)) < 0.003
    normalised = offsets / np.array([np.hypot(measured.sigma, measured.shift.sigma) for measured in certain])
    assert np.mean(np.abs(normalised) < 3.0) > 0.7
    level = [measured for measured in certain if measured.edge.horizontal and measured.edge.length > 0.5]
    assert all(abs(measured.fit.slope) < np.radians(1.25) for measured in level)


@pytest.mark.parametrize(("right", "up"), [(0.005, 0.0), (0.0, -0.005), (-0.004, 0.004)])
def test_edges_move_against_the_pose(right: float, up: float, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    before = {measured.edge: measured for measured in edges_at(shot, POSE, t11)}
    after = {measured.edge: measured for measured in edges_at(shot, moved(POSE, right, up=up), t11)}
    common = [edge for edge in before if edge in after and before[edge].fit.coverage > 0.6]
    assert len(common) >= 6
    expected = np.array([-right * edge.outward[0] - up * edge.outward[1] for edge in common])
    found = np.array([after[edge].fit.offset - before[edge].fit.offset for edge in common])
    assert np.median(np.abs(found - expected)) < 0.0005
    assert np.mean(np.abs(found - expected) < 0.0015) > 0.7


def test_pixels_are_larger_aslant_and_faces_as_wide_as_their_ends(portrait: Portrait, t11: PalletModel) -> None:
    edges = edges_at(portrait(t11, POSE), POSE, t11)
    across = {measured.edge.horizontal: measured.pixel for measured in edges}
    straight = np.hypot(float(np.hypot(POSE.x - 0.3, POSE.y + 0.08)), 1.85) / 560.0
    assert across[False] > straight
    assert across[True] > straight  # seen from 40 degrees above
    shot = portrait(t11, POSE)
    seen = seen_at(shot, POSE, t11)
    ends = POSE.transform().apply([[0.0, side * t11.width / 2, t11.height / 2] for side in (-1, 1)])
    pixels = shot.project(ends).pixels
    assert seen.width_px(t11.width) == pytest.approx(float(np.linalg.norm(pixels[1] - pixels[0])), rel=0.03)
    assert replace(seen, edges=()).width_px(t11.width) == 0.0


def test_lines_are_expected_unless_loaded_above_or_hidden_below(t11: PalletModel, portrait: Portrait) -> None:
    above, high = portrait(t11, POSE), replace(POSE, z=2.6)
    below = portrait(t11, high)
    for shot, pose, loaded in ((above, POSE, True), (below, high, False)):
        seen = seen_at(shot, pose, t11)
        kinds = {line.kind: seen.loaded(line.whole) for line in face_lines(t11)}
        assert kinds.pop(EdgeKind.TOP) is loaded
        assert not any(kinds.values())
    high = replace(POSE, z=2.6)
    seen = seen_at(portrait(t11, high), high, t11)
    assert EdgeKind.BOTTOM not in {measured.edge.kind for measured in seen.edges}
    lines = [line.whole for line in face_lines(t11) if line.kind != EdgeKind.BOTTOM]
    assert seen.expected == pytest.approx(sum(seen.evidence_weight(line) for line in lines))
    seen = seen_at(portrait(t11, POSE), POSE, t11)
    assert seen.expected == pytest.approx(len(face_lines(t11)) - 1 - (1 - BORDERING))


@pytest.mark.parametrize(("aside", "bordering"), [(-1.5, "left"), (0.0, None), (0.5, None), (1.5, "right")])
def test_a_pallets_own_side_begins_at_the_edge_towards_who_stands_aside(
    portrait: Portrait, t11: PalletModel, aside: float, bordering: str | None
) -> None:
    seen = seen_at(portrait(t11, POSE), POSE, t11)
    beside = replace(seen, plane_from_camera=np.array([aside, 1.0, 2.0]))
    left, right = (line.whole for line in face_lines(t11) if line.kind is EdgeKind.SIDE)
    assert [beside.borders_on_side(edge) for edge in (left, right)] == [bordering == "left", bordering == "right"]
    weights = {beside.evidence_weight(left), beside.evidence_weight(right)}
    assert weights == ({1.0} if bordering is None else {1.0, BORDERING})


@pytest.mark.parametrize("x", [-0.8, 2.6, 40.0])
def test_a_face_cut_by_the_border_is_not_measured(x: float, portrait: Portrait, t11: PalletModel) -> None:
    assert measure_face(portrait(t11, POSE), replace(POSE, x=x), t11, REACH) is Reason.OUT_OF_VIEW


@pytest.mark.parametrize("behind", [replace(POSE, yaw=POSE.yaw + np.pi), LevelPose(0.3, 0.0, 0.0, POSE.yaw)])
def test_from_behind_there_is_no_face(behind: LevelPose, portrait: Portrait, t11: PalletModel) -> None:
    assert measure_face(portrait(t11, POSE), behind, t11, REACH) is Reason.BEHIND_FACE


@pytest.mark.parametrize("grown", [0.0023, -0.0037])
def test_drawn_edges_are_measured_to_a_tenth_of_a_pixel(model: PalletModel, grown: float, shoot_face: Shoots) -> None:
    sharp = replace(model, edge_radius=0.0)
    camera = Pinhole(900, 320, 900.0, 900.0, 449.5, 159.5)
    turned = Rotation.from_euler("ZYX", [1.25, 0.42, 0.03])
    mounting = Mounting(RigidTransform.from_components([0.3, 0.1, 1.1], turned))
    pose = LevelPose(0.9, 2.1, 0.0, np.pi / 2 - 0.15)
    shot = blank(camera, mounting)
    shot = replace(shot, image=shoot_face(camera, shot.camera_from_face(pose), sharp, grown))
    seen = seen_at(shot, pose, sharp, EdgeReach(0.011, 0.011, 1.5))
    assert len(seen.edges) == len(face_lines(model))
    for measured in seen.edges:
        assert measured.fit.coverage > 0.9
        assert measured.fit.offset == pytest.approx(grown, abs=0.1 * measured.pixel)
        assert abs(measured.fit.slope) * measured.edge.length < 0.2 * measured.pixel


@pytest.mark.parametrize("columns", [0, 1, 480, 951])
def test_faces_across_the_seam_are_measured_like_others(columns: int, shoot_face: Shoots, t11: PalletModel) -> None:
    camera, sharp = Equirectangular(1600, 800), replace(t11, edge_radius=0.0)
    tilted = Rotation.from_euler("ZYX", [0.0, 0.02, 0.01])
    mounting = Mounting(RigidTransform.from_components([0.0, 0.0, 0.9], tilted))
    pose = LevelPose(1.5, 0.1, 0.0, 0.1)
    shot = blank(camera, mounting)
    image = shoot_face(camera, shot.camera_from_face(pose), sharp)
    shift = camera.width // 2 + columns  # the face lies in the middle of the image
    turn = LevelPose(0.0, 0.0, 0.0, 2 * np.pi * shift / camera.width).transform()
    turned = Mounting(mounting.forklift_from_camera * turn)
    straight, across = (
        seen_at(Shot(picture, camera, where), pose, sharp)
        for picture, where in ((image, mounting), (np.roll(image, shift, axis=1), turned))
    )
    assert len(straight.edges) == len(across.edges) == len(face_lines(t11))
    for measured, other in zip(straight.edges, across.edges, strict=True):
        assert other.edge == measured.edge
        assert other.fit.offset == pytest.approx(measured.fit.offset, abs=0.01 * measured.pixel)
        assert other.pixel == pytest.approx(measured.pixel, rel=1e-6)
    np.testing.assert_allclose(across.plane_from_camera, shot.camera_in(pose), atol=1e-9)


def test_edges_carry_what_their_face_says_and_colour_matters_little(portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    gray = replace(shot, image=np.asarray(shot.image.mean(axis=2), dtype=np.uint8))
    same = replace(shot, image=np.repeat(gray.image[..., None], 3, axis=2))
    first, other = edges_at(gray, POSE, epal), edges_at(same, POSE, epal)
    assert [edge.edge for edge in first] == [edge.edge for edge in other]
    np.testing.assert_allclose([e.fit.offset for e in first], [e.fit.offset for e in other], atol=1e-6)
    seen = seen_at(portrait(epal, POSE), POSE, epal)
    assert set(seen.lines) == {line.whole for line in face_lines(epal)}
    for measured in seen.edges:
        assert measured.evidence_weight == seen.evidence_weight(measured.edge)


def test_a_plain_image_has_no_edges(portrait: Portrait, t11: PalletModel) -> None:
    assert edges_at(blanked(portrait(t11, POSE), 100), POSE, t11) == ()


def test_lines_behind_something_are_hidden_and_not_measured(portrait: Portrait, epal: PalletModel) -> None:
    shot, before = portrait(epal, POSE), (0.35, 0.61)
    free, seen = (measure_face(shot, POSE, epal, REACH, spans) for spans in ((), (before,)))
    assert isinstance(free, SeenFace)
    assert isinstance(seen, SeenFace)
    assert free.hidden_lines == ()
    assert seen.hidden == (before,)
    assert seen.hidden_part == pytest.approx((before[1] - before[0]) / epal.width)
    (side,) = (line for line in seen.hidden_lines if line.kind is EdgeKind.SIDE)
    assert side.middle[0] == pytest.approx(epal.width / 2)
    assert {measured.edge for measured in seen.edges} == {e.edge for e in free.edges} - set(seen.hidden_lines)
    assert seen.expected == pytest.approx(free.expected - sum(map(seen.evidence_weight, seen.hidden_lines)))
