from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc import LevelPose, PalletModel, load_library
from palletloc.cameras import CameraModel, Equirectangular, Pinhole
from palletloc.drawing.outline import face_outline, place_outline, project_line, sampled, seen_on_plane, stretches_of
from palletloc.drawing.overlay import Mark, Region, cut_out, draw_overlay, region_of_interest
from palletloc.face import EdgeKind, face_lines
from palletloc.geometry import FloatArray, Image

LIBRARY = load_library()
FACES = [
    pytest.param([LIBRARY["epal1-1200"]], id="closed"),
    pytest.param([LIBRARY["epal1-800"]], id="open below"),
    pytest.param([LIBRARY["t11-plastic"]], id="rounded"),
    pytest.param(list(LIBRARY.values()), id="library"),
]
CAMERA = Equirectangular(2000, 1000)
IDENTITY = RigidTransform.identity()


def area(line: FloatArray) -> float:
    """Return the area inside a closed line."""
    x, y = line.T
    return abs(float(x[:-1] @ y[1:] - x[1:] @ y[:-1])) / 2


@pytest.mark.parametrize("models", FACES)
def test_the_lines_enclose_the_solid_part_and_the_closed_openings_and_reach_all_sides(
    models: list[PalletModel],
) -> None:
    for model in models:
        outline, *openings = face_outline(model, step=0.003)
        feet = [opening for opening in model.openings if opening.open_below]
        corner = 1 - np.pi / 4  # what rounding takes from the square of the radius
        solid = model.width * model.height - 4 * corner * model.corner_radius**2
        solid -= sum(opening.width * opening.height - 2 * corner * opening.radius**2 for opening in feet)
        assert area(outline) == pytest.approx(solid, rel=1e-3)
        assert outline.min(axis=0) == pytest.approx([-model.width / 2, 0.0])
        assert outline.max(axis=0) == pytest.approx([model.width / 2, model.height])
        closed = [opening for opening in model.openings if not opening.open_below]
        for line, opening in zip(openings, closed, strict=True):
            expected = opening.width * opening.height - 4 * corner * opening.radius**2
            assert area(line) == pytest.approx(expected, rel=5e-3)


def test_sharp_corners_are_kept() -> None:
    model = replace(LIBRARY["epal1-1200"], corner_radius=0.0)
    corners = [(x, y) for x in (-0.6, 0.6) for y in (0.0, model.height)]
    outline = face_outline(model, step=0.07)[0]
    assert all(np.hypot(*(outline - corner).T).min() < 1e-12 for corner in corners)


@given(step=st.floats(0.002, 2.0))
def test_neighbours_are_at_most_a_step_apart(step: float) -> None:
    line = np.array([[0.0, 0.0], [0.5, 0.0], [0.5, 0.3]])
    dense = sampled(line, step)
    assert np.hypot(*np.diff(dense, axis=0).T).max() <= step * (1 + 1e-6)
    assert all(np.hypot(*(dense - point).T).min() < 1e-12 for point in line)


def test_a_placed_face_stands_across_its_heading() -> None:
    model = LIBRARY["t11-plastic"]
    points = np.concatenate(place_outline(model, LevelPose(2.0, 3.0, 0.4, np.radians(90))))
    assert points[:, 1] == pytest.approx(np.full(len(points), 3.0))  # the face looks along y
    assert points[:, 0].min() == pytest.approx(2.0 - model.width / 2)
    assert points[:, 2].min() == pytest.approx(0.4)
    assert points[:, 2].max() == pytest.approx(0.4 + model.height)


def test_the_faces_right_side_is_the_pallets_minus_y() -> None:
    uneven = load_library()["t11-plastic"]
    first = replace(uneven.openings[0], width=0.1)
    model = replace(uneven, openings=(first, uneven.openings[1]))
    _, left, right = place_outline(model, LevelPose(0.0, 0.0, 0.0, 0.0))
    assert np.ptp(left[:, 1]) == pytest.approx(0.1)
    assert left[:, 1].min() > 0 > right[:, 1].max()


@given(
    point=st.tuples(*[st.floats(-2, 2)] * 3), camera=st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(2.5, 6))
)
def test_a_point_and_where_a_plane_shows_it_lie_on_one_ray_if_it_is_before_the_camera(
    point: tuple[float, float, float], camera: tuple[float, float, float]
) -> None:
    shown = seen_on_plane(np.array([point]), np.array(camera))[0]
    to_point, to_shown = np.subtract(point, camera), np.subtract([*shown, 0.0], camera)
    assert np.linalg.norm(np.cross(to_point, to_shown)) < 1e-9 * np.linalg.norm(to_point) * 1e3
    assert to_point @ to_shown > 0
    behind, beside = seen_on_plane(np.array([[0.3, 0.0, 2.5], [0.3, 0.1, 0.0]]), np.array([0.0, 0.0, 2.0]))
    assert np.isnan(behind).all()
    assert beside == pytest.approx([0.3, 0.1])


def line_behind(offset: float) -> FloatArray:
    """Return a level line 2 m behind the camera; with an offset of 0 the seam halves it."""
    return np.column_stack([np.full(200, -2.0), np.linspace(-1, 1, 200) + offset, np.full(200, -0.5)])


def test_a_line_that_crosses_the_seam_leaves_at_both_sides_without_a_jump() -> None:
    pieces = project_line(CAMERA, IDENTITY, line_behind(0.0))
    assert len(pieces) == 2
    for piece in pieces:
        assert np.abs(np.diff(piece[:, 0])).max() < 10
    inside = [piece[(piece[:, 0] > -0.5) & (piece[:, 0] < 1999.5), 0] for piece in pieces]
    left, right = sorted(inside, key=np.mean)
    assert (left.min(), right.max()) == (pytest.approx(0, abs=5), pytest.approx(1999, abs=5))
    assert left.max() < 400 < 1600 < right.min()
    assert len(left) + len(right) == 200


def test_a_line_beside_the_seam_is_one_piece_where_the_camera_puts_it() -> None:
    (piece,) = project_line(CAMERA, IDENTITY, line_behind(1.5))
    assert piece == pytest.approx(CAMERA.project(line_behind(1.5)).pixels)


def test_only_what_a_camera_sees_is_drawn() -> None:
    camera = Pinhole(200, 100, 120.0, 120.0, 99.5, 49.5)
    ring = np.array([[np.cos(a), np.sin(a), 0.0] for a in np.linspace(0, 2 * np.pi, 720)])
    pixels = np.concatenate(project_line(camera, IDENTITY, ring))
    assert len(pixels) < 300
    assert pixels[:, 1] == pytest.approx(np.full(len(pixels), 49.5))
    assert project_line(camera, IDENTITY, -ring[:40] - [5.0, 0.0, 0.0]) == []


def test_a_camera_elsewhere_sees_the_line_from_there() -> None:
    forklift_from_camera = RigidTransform.from_components([0.3, 0.1, 1.8], Rotation.from_rotvec([0, 0, 0.4]))
    line = np.column_stack([np.full(50, 2.0), np.linspace(0, 1, 50), np.zeros(50)])
    (piece,) = project_line(CAMERA, forklift_from_camera.inv(), line)
    assert piece == pytest.approx(CAMERA.project(forklift_from_camera.inv().apply(line)).pixels)


@pytest.mark.parametrize("models", FACES)
def test_stretches_of_a_line_are_the_edges_on_it(models: list[PalletModel]) -> None:
    for model in models:
        for line in face_lines(model):
            stretches = stretches_of(model, line.whole)
            assert len(stretches) == len(line.edges)
            assert stretches[0][0] == pytest.approx(line.whole.start)
            assert stretches[-1][1] == pytest.approx(line.whole.end)
        tops = [line for line in face_lines(model) if line.kind is EdgeKind.OPENING_TOP]
        assert sum(len(line.edges) for line in tops) == len(model.openings)


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


def test_the_region_of_a_face_across_the_seam_is_small_and_without_marks_it_is_the_whole_image() -> None:
    assert region_of_interest(ROUND, CAMERA_FROM_FORKLIFT, [BEHIND]).width < ROUND.width / 3
    assert region_of_interest(ROUND, CAMERA_FROM_FORKLIFT, []) == Region(0, 0, 1600, 800)


def test_a_region_of_a_flat_camera_stays_inside() -> None:
    near_border = Mark(MODEL, LevelPose(3.0, 1.6, 1.2, 0.0), GREEN)
    region = region_of_interest(NARROW, CAMERA_FROM_FORKLIFT, [near_border])
    assert 0 <= region.left <= region.left + region.width <= NARROW.width


def test_a_region_across_the_seam_joins_both_sides() -> None:
    image = np.arange(10, dtype=np.uint8)[None].repeat(4, axis=0)
    assert cut_out(image, Region(-2, 1, 5, 2)).tolist() == [[8, 9, 0, 1, 2]] * 2
