from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc.geometry import BoolArray, FloatArray
from palletloc.paper.boundary import BoundaryLine, boundary_lines
from palletloc.plane import PlaneGrid, PlaneView

GRID = PlaneGrid.spanning(-0.6, 0.6, -0.12, 0.15, 0.004)
STEP, MAX_TURN = np.radians(0.25), np.radians(12.0)
METHODS = pytest.mark.parametrize("two_region", [False, True], ids=["edges", "two_region"])


def shares(turn: float, up: float) -> FloatArray:
    """How much of each pixel lies beyond a line, towards larger ``up``."""
    columns, rows = np.meshgrid(np.arange(GRID.columns), np.arange(GRID.rows))
    right, above = np.moveaxis(GRID.points(np.stack([columns, rows], -1).astype(np.float64)), -1, 0)
    beyond = (above - up - right * np.tan(turn)) * np.cos(turn) / GRID.resolution
    return np.asarray(np.clip(beyond + 0.5, 0.0, 1.0))


def view_of(levels: FloatArray, noise: float = 2.0, valid: BoolArray | None = None) -> PlaneView:
    noisy = levels + np.random.default_rng(0).normal(0.0, noise, levels.shape)
    everywhere = np.ones(levels.shape, dtype=bool)
    image = np.clip(np.round(noisy), 0, 255).astype(np.uint8)
    return PlaneView(image, everywhere if valid is None else valid, GRID, RigidTransform.identity())


def half_planes(turn: float, up: float, near: float = 160.0, far: float = 70.0) -> PlaneView:
    return view_of(near + (far - near) * shares(turn, up))


def lines_of(view: PlaneView, two_region: bool) -> list[BoundaryLine]:
    return boundary_lines(view, two_region, MAX_TURN, STEP)


@METHODS
@pytest.mark.parametrize("turn_deg", [-9.0, -2.1, 0.0, 0.4, 5.0])
@pytest.mark.parametrize("up", [-0.02, 0.013])
def test_a_boundary_is_found_within_what_a_pixel_over_its_length_resolves(
    two_region: bool, turn_deg: float, up: float
) -> None:
    best = lines_of(half_planes(np.radians(turn_deg), up), two_region)[0]
    resolved = GRID.resolution / 1.2
    assert best.turn == pytest.approx(np.radians(turn_deg), abs=STEP + resolved)
    assert best.up == pytest.approx(up, abs=1.5 * GRID.resolution)
    assert best.votes > 0.4 * GRID.columns


@METHODS
@pytest.mark.parametrize(("near", "far"), [(60.0, 170.0), (200.0, 90.0)])
def test_it_does_not_matter_which_side_is_bright(two_region: bool, near: float, far: float) -> None:
    best = lines_of(half_planes(np.radians(3.0), 0.02, near, far), two_region)[0]
    assert best.turn == pytest.approx(np.radians(3.0), abs=2 * STEP)
    assert best.up == pytest.approx(0.02, abs=1.5 * GRID.resolution)


@METHODS
def test_the_mirrored_view_has_the_opposite_turn(two_region: bool) -> None:
    view = half_planes(np.radians(4.0), 0.01)
    mirrored = PlaneView(view.image[:, ::-1].copy(), view.valid, GRID, view.camera_from_plane)
    one, other = lines_of(view, two_region)[0], lines_of(mirrored, two_region)[0]
    assert one.turn > 0 > other.turn
    assert other.turn == pytest.approx(-one.turn, abs=2 * (STEP + GRID.resolution / 1.2))
    assert other.up == pytest.approx(one.up, abs=1.5 * GRID.resolution)


@METHODS
def test_colour_is_read_as_well_as_gray(two_region: bool) -> None:
    gray = half_planes(np.radians(2.0), 0.0)
    colour = PlaneView(np.dstack([gray.image] * 3), gray.valid, GRID, gray.camera_from_plane)
    assert lines_of(colour, two_region) == lines_of(gray, two_region)


@METHODS
def test_there_is_no_line_in_a_plain_view(two_region: bool) -> None:
    assert lines_of(view_of(np.full((GRID.rows, GRID.columns), 120.0), noise=0.0), two_region) == []


@METHODS
def test_a_line_that_turns_too_far_is_not_returned(two_region: bool) -> None:
    lines = boundary_lines(half_planes(np.radians(9.0), 0.01), two_region, np.radians(3.0), STEP)
    assert all(abs(line.turn) <= np.radians(3.0) + STEP for line in lines)
    assert all(line.votes < 0.7 * GRID.columns for line in lines)


@METHODS
def test_what_the_camera_does_not_see_draws_no_line(two_region: bool) -> None:
    unseen = half_planes(0.0, 0.01)
    seen = np.broadcast_to(np.arange(GRID.columns) < 0.2 * GRID.columns, unseen.valid.shape)
    assert lines_of(PlaneView(unseen.image, seen, GRID, unseen.camera_from_plane), two_region) == []


def test_edges_find_several_lines_and_the_longest_comes_first() -> None:
    long = 80.0 * shares(np.radians(-1.0), -0.05)
    short = 80.0 * shares(np.radians(3.0), 0.06)
    short[:, : GRID.columns // 2] = short[0, 0]
    lines = lines_of(view_of(40.0 + long + short), two_region=False)
    assert [line.votes for line in lines] == sorted((line.votes for line in lines), reverse=True)
    assert lines[0].turn == pytest.approx(np.radians(-1.0), abs=2 * STEP)
    assert any(abs(line.turn - np.radians(3.0)) < 3 * STEP and abs(line.up - 0.06) < 0.008 for line in lines)


def test_two_regions_give_the_boundary_nearest_to_the_aisle() -> None:
    levels = 170.0 - 100.0 * shares(np.radians(1.0), -0.04) + 100.0 * shares(np.radians(1.0), 0.08)
    best = lines_of(view_of(levels), two_region=True)[0]
    assert best.up == pytest.approx(-0.04, abs=2 * GRID.resolution)
