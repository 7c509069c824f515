import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc.cameras import CameraModel, Equirectangular, Pinhole
from palletloc.drawing.overlay import Mark, Region, cut_out, draw_overlay, region_of_interest
from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.pallet_library import load_library

MODEL = load_library()["epal1-1200"]
ROUND = Equirectangular(1600, 800)
NARROW = Pinhole(640, 320, 400.0, 400.0, 319.5, 159.5)
CAMERA_FROM_FORKLIFT = RigidTransform.from_translation([0.0, 0.0, -1.5])
GREEN = "#00ff00"
AHEAD = Mark(MODEL, LevelPose(3.0, 0.2, 1.2, 0.1), GREEN, heading=False)
BEHIND = Mark(MODEL, LevelPose(-2.0, 0.1, 0.3, np.pi), GREEN, heading=False)


def blank(camera: CameraModel) -> Image:
    return np.full((camera.height, camera.width, 3), 128, np.uint8)


def green_at(image: Image) -> tuple[FloatArray, FloatArray]:
    """Return rows and columns of all pixels in the mark's colour."""
    rows, columns = np.nonzero((image == [0, 255, 0]).all(axis=-1))
    return rows.astype(np.float64), columns.astype(np.float64)


@pytest.mark.parametrize("camera", [ROUND, NARROW], ids=["equirectangular", "pinhole"])
def test_the_outline_runs_through_the_faces_corners(camera: CameraModel) -> None:
    rows, columns = green_at(draw_overlay(blank(camera), camera, CAMERA_FROM_FORKLIFT, [AHEAD]))
    half, radius = MODEL.width / 2, MODEL.corner_radius
    for side in (-half, half):
        for up in (radius, MODEL.height - radius):
            point = AHEAD.forklift_from_pallet.transform().apply([0.0, side, up])
            u, v = camera.project(CAMERA_FROM_FORKLIFT.apply(point)).pixels
            assert np.hypot(rows - v, columns - u).min() < 2.0


def test_nothing_is_drawn_inside_the_blocks() -> None:
    rows, columns = green_at(draw_overlay(blank(NARROW), NARROW, CAMERA_FROM_FORKLIFT, [AHEAD]))
    for left, right in MODEL.blocks:
        middle = -(left + right) / 2, (MODEL.openings[0].bottom + MODEL.openings[0].top) / 2
        point = AHEAD.forklift_from_pallet.transform().apply([0.0, *middle])
        u, v = NARROW.project(CAMERA_FROM_FORKLIFT.apply(point)).pixels
        assert np.hypot(rows - v, columns - u).min() > 4.0


def test_an_outline_across_the_seam_draws_no_line_across_the_picture() -> None:
    image = draw_overlay(blank(ROUND), ROUND, CAMERA_FROM_FORKLIFT, [BEHIND])
    changed = np.flatnonzero((image != 128).any(axis=(0, 2)))
    assert (changed[0], changed[-1]) == (0, ROUND.width - 1)
    assert not ((changed > 250) & (changed < ROUND.width - 250)).any()


def test_the_shot_stays_as_it_is_and_may_be_gray() -> None:
    gray = np.full((ROUND.height, ROUND.width), 128, np.uint8)
    drawn = draw_overlay(gray, ROUND, CAMERA_FROM_FORKLIFT, [AHEAD])
    assert (gray == 128).all()
    assert (drawn == draw_overlay(blank(ROUND), ROUND, CAMERA_FROM_FORKLIFT, [AHEAD])).all()
    assert (drawn != 128).any()


def test_a_label_stands_above_the_face() -> None:
    plain = draw_overlay(blank(NARROW), NARROW, CAMERA_FROM_FORKLIFT, [AHEAD])
    named = Mark(AHEAD.model, AHEAD.forklift_from_pallet, GREEN, "P1", heading=False)
    rows = np.flatnonzero((draw_overlay(blank(NARROW), NARROW, CAMERA_FROM_FORKLIFT, [named]) != plain).any((1, 2)))
    top = AHEAD.forklift_from_pallet.transform().apply([0.0, 0.0, MODEL.height])
    assert len(rows) > 5
    assert rows.max() < NARROW.project(CAMERA_FROM_FORKLIFT.apply(top)).pixels[1] + 1


def test_the_heading_is_drawn_into_the_aisle() -> None:
    mark = Mark(MODEL, AHEAD.forklift_from_pallet, GREEN)
    rows, columns = green_at(draw_overlay(blank(ROUND), ROUND, CAMERA_FROM_FORKLIFT, [mark]))
    tip = mark.forklift_from_pallet.transform().apply([-0.6, 0.0, 0.0])
    u, v = ROUND.project(CAMERA_FROM_FORKLIFT.apply(tip)).pixels
    assert np.hypot(rows - v, columns - u).min() < 2.5


def test_what_no_camera_sees_is_not_drawn() -> None:
    shown = Mark(MODEL, BEHIND.forklift_from_pallet, GREEN, "P1")
    assert (draw_overlay(blank(NARROW), NARROW, CAMERA_FROM_FORKLIFT, [shown]) == 128).all()


def contains(region: Region, camera: CameraModel, mark: Mark) -> bool:
    corners = [[0.0, side, up] for side in (-0.6, 0.6) for up in (0.0, MODEL.height)]
    points = mark.forklift_from_pallet.transform().apply(corners)
    u, v = camera.project(CAMERA_FROM_FORKLIFT.apply(points)).pixels.T
    beside = (u - region.left) % camera.width
    return bool((beside < region.width).all() and ((v > region.top) & (v < region.top + region.height)).all())


@pytest.mark.parametrize("marks", [[AHEAD], [BEHIND], [AHEAD, BEHIND]], ids=["ahead", "seam", "both"])
def test_the_region_holds_every_face(marks: list[Mark]) -> None:
    region = region_of_interest(ROUND, CAMERA_FROM_FORKLIFT, marks)
    assert all(contains(region, ROUND, mark) for mark in marks)
    assert 0 <= region.top <= region.top + region.height <= ROUND.height
    assert region.width <= ROUND.width


def test_the_region_of_a_face_across_the_seam_is_small() -> None:
    assert region_of_interest(ROUND, CAMERA_FROM_FORKLIFT, [BEHIND]).width < ROUND.width / 3


def test_a_region_of_a_flat_camera_stays_inside() -> None:
    near_border = Mark(MODEL, LevelPose(3.0, 1.6, 1.2, 0.0), GREEN)
    region = region_of_interest(NARROW, CAMERA_FROM_FORKLIFT, [near_border])
    assert 0 <= region.left <= region.left + region.width <= NARROW.width


def test_without_marks_the_region_is_the_whole_image() -> None:
    assert region_of_interest(ROUND, CAMERA_FROM_FORKLIFT, []) == Region(0, 0, 1600, 800)


def test_a_region_across_the_seam_joins_both_sides() -> None:
    image = np.arange(10, dtype=np.uint8)[None].repeat(4, axis=0)
    assert cut_out(image, Region(-2, 1, 5, 2)).tolist() == [[8, 9, 0, 1, 2]] * 2
