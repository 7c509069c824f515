from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc import LevelPose, PalletModel, Shot
from palletloc.geometry import BoolArray, FloatArray
from palletloc.measurement import Reason, YawSource
from palletloc.paper import horizontal_view
from palletloc.paper.boundary import BoundaryLine, boundary_lines
from palletloc.paper.horizontal_view import BoundaryMethod, HorizontalView, YawConfig, view_horizontal
from palletloc.paper.yaw import YawEstimate, find_lines, measure_line, measure_yaw
from palletloc.plane import PlaneGrid, PlaneView
from tests.palletloc.poses import POSE, Portrait, blanked, moved, slid

HIGH = replace(POSE, z=3.3)
CONFIG = YawConfig()


def viewed(
    shot: Shot, model: PalletModel, start: LevelPose = POSE, source: YawSource = YawSource.BOTTOM
) -> HorizontalView:
    return view_horizontal(shot, start, model, source, CONFIG)


def measured(
    shot: Shot, model: PalletModel, start: LevelPose = POSE, source: YawSource = YawSource.BOTTOM
) -> YawEstimate:
    """The yaw, with the plane placed again by the first result."""
    first = measured_once(shot, model, start, source)
    return measured_once(shot, model, replace(start, yaw=first.yaw), source)


def measured_once(shot: Shot, model: PalletModel, start: LevelPose, source: YawSource) -> YawEstimate:
    found = measure_yaw(shot, viewed(shot, model, start, source), start, model, CONFIG)
    assert isinstance(found, YawEstimate)
    return found


@pytest.mark.parametrize("yaw_deg", [-6.0, 1.1, 5.0])
@pytest.mark.parametrize("x", [0.3, 1.8])
def test_the_yaw_of_a_pallet_on_the_floor_is_within_three_sigma(
    model: PalletModel, yaw_deg: float, x: float, portrait: Portrait
) -> None:
    pose = LevelPose(x, 2.0, 0.0, np.pi / 2 + np.radians(yaw_deg))
    found = measured(portrait(model, pose), model, pose)
    assert abs(found.yaw - pose.yaw) < 3 * found.sigma
    assert found.sigma < np.radians(1.0)
    assert found.source in (YawSource.BOTTOM, YawSource.OPENING_TOP, YawSource.OPENING_BOTTOM)


def test_above_the_camera_upper_edges_give_the_yaw_and_equal_views_equal_results(
    portrait: Portrait, epal: PalletModel
) -> None:
    found = measured(portrait(epal, HIGH), epal, HIGH, YawSource.TOP)
    assert abs(found.yaw - HIGH.yaw) < 3 * found.sigma
    assert found.source is not YawSource.BOTTOM
    assert found.sigma < np.radians(1.0)
    shot = portrait(epal, POSE)
    assert measured(shot, epal) == measured(shot, epal)


@pytest.mark.parametrize("factor", [0.95, 0.98, 1.03])
def test_moving_along_the_viewing_ray_leaves_the_yaw(factor: float, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    here, there = measured(shot, t11), measured(shot, t11, slid(shot, POSE, factor))
    assert there.yaw == pytest.approx(here.yaw, abs=np.radians(0.12))


@pytest.mark.parametrize("turn_deg", [-1.5, -0.5, 1.0, 1.5])
def test_any_start_near_the_truth_gives_the_same_yaw(turn_deg: float, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    found = measured(shot, t11, moved(POSE, turn_deg=turn_deg))
    assert found.yaw == pytest.approx(measured(shot, t11).yaw, abs=np.radians(0.05))


def test_the_estimate_is_the_mean_of_the_votes_that_agree(portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    found = measure_yaw(shot, viewed(shot, epal, POSE, YawSource.BOTTOM), POSE, epal, CONFIG)
    assert isinstance(found, YawEstimate)
    used = [vote for vote in found.votes if vote.used]
    assert len(used) >= 2
    weights = np.array([vote.sigma**-2 for vote in used])
    mean = float((weights * [vote.turn for vote in used]).sum() / weights.sum())
    assert found.yaw == pytest.approx(POSE.yaw + mean, abs=1e-9)
    assert found.sigma >= weights.sum() ** -0.5 - 1e-12
    assert all(vote.edge.horizontal for vote in found.votes)


def test_an_edge_that_is_partly_hidden_does_not_turn_the_yaw(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    seen = viewed(shot, t11, POSE, YawSource.BOTTOM)
    image = seen.view.image.copy()
    grid = seen.view.grid
    left, right = (round((edge - grid.left) / grid.resolution) for edge in (0.35, 0.55))
    middle = round(grid.top / grid.resolution)
    image[middle + 3 :, left:right] = image[5, 5]  # something of the floor's colour stands before the lower edge
    found = measure_yaw(shot, replace(seen, view=replace(seen.view, image=image)), POSE, t11, CONFIG)
    assert isinstance(found, YawEstimate)
    assert abs(found.yaw - POSE.yaw) < max(3 * found.sigma, np.radians(0.3))


def test_there_is_no_yaw_in_a_plain_image(portrait: Portrait, t11: PalletModel) -> None:
    plain = blanked(portrait(t11, POSE))
    seen = viewed(plain, t11, POSE, YawSource.BOTTOM)
    assert measure_yaw(plain, seen, POSE, t11, CONFIG) is Reason.NO_LINE
    assert find_lines(seen, CONFIG) == []
    assert measure_line(plain, seen, BoundaryLine(0.01, 0.0, 200), t11, CONFIG) is None


@pytest.mark.parametrize("turn_deg", [-6.0, -2.0, 2.0, 6.0])
@pytest.mark.parametrize("boundary", BoundaryMethod)
def test_a_boundary_line_shows_how_far_the_start_is_turned(
    turn_deg: float, boundary: BoundaryMethod, portrait: Portrait, t11: PalletModel
) -> None:
    seen = viewed(portrait(t11, POSE), t11, moved(POSE, turn_deg=turn_deg), YawSource.BOTTOM)
    lines = find_lines(seen, replace(CONFIG, boundary=boundary))
    assert min(abs(line.turn + np.radians(turn_deg)) for line in lines) < np.radians(0.7)


@pytest.mark.parametrize("turn_deg", [-5.0, 3.0])
def test_a_line_is_measured_finer_than_it_was_found(turn_deg: float, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    seen = viewed(shot, t11, moved(POSE, turn_deg=turn_deg), YawSource.BOTTOM)
    line = min(find_lines(seen, CONFIG), key=lambda line: (round(abs(line.up), 2), -line.votes))
    fit = measure_line(shot, seen, line, t11, CONFIG)
    assert fit is not None
    assert abs(np.arctan(fit.slope) + np.radians(turn_deg)) < np.radians(0.3)


# Views of level planes.


@pytest.mark.parametrize("distance", [0.8, 2.0, 4.0])
def test_the_plane_is_below_level_or_above_as_the_pallet_is(distance: float, epal: PalletModel) -> None:
    far = distance / CONFIG.max_lever + epal.height + 0.01
    middle = epal.height / 2
    chosen = [
        horizontal_view.horizontal_source(epal, np.array([0.4, height, distance]), CONFIG)
        for height in (far, middle, -far)
    ]
    assert chosen == [YawSource.BOTTOM, YawSource.FACE, YawSource.TOP]


def test_the_farther_the_face_the_wider_the_band_without_a_plane(epal: PalletModel) -> None:
    heights = np.linspace(-2.0, 2.0, 401)
    without = [
        sum(
            horizontal_view.horizontal_source(epal, np.array([0.4, z, distance]), CONFIG) is YawSource.FACE
            for z in heights
        )
        for distance in (1.5, 2.5, 3.5)
    ]
    assert 0 < without[0] < without[1] < without[2]


@pytest.mark.parametrize("source", [YawSource.BOTTOM, YawSource.TOP])
def test_the_plane_goes_level_through_the_edge(source: YawSource, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    seen = viewed(shot, t11, source=source)
    assert seen.source is source
    assert seen.height == (0.0 if source is YawSource.BOTTOM else t11.height)
    forklift_from_plane = shot.mounting.forklift_from_camera * seen.view.camera_from_plane
    into = [np.cos(POSE.yaw), np.sin(POSE.yaw), 0.0]
    np.testing.assert_allclose(
        forklift_from_plane.apply(np.zeros(3)), [POSE.x, POSE.y, POSE.z + seen.height], atol=1e-9
    )
    np.testing.assert_allclose(forklift_from_plane.rotation.apply([0.0, 1.0, 0.0]), into, atol=1e-9)
    np.testing.assert_allclose(forklift_from_plane.apply(seen.plane_from_camera), shot.mounting.center, atol=1e-9)


@pytest.mark.parametrize("source", [YawSource.BOTTOM, YawSource.TOP])
def test_every_level_edge_of_a_face_is_in_the_view(source: YawSource, portrait: Portrait, epal: PalletModel) -> None:
    seen = viewed(portrait(epal, POSE), epal, source=source)
    grid, camera = seen.view.grid, seen.plane_from_camera
    low, high = grid.top - (grid.rows - 1) * grid.resolution, grid.top
    for height in (0.0, 0.022, 0.122, epal.height):
        # the edge's point over the plane, seen from the camera
        point = np.array([0.0, 0.0, height - seen.height])
        reached = camera + (point - camera) * camera[2] / (camera[2] - point[2])
        assert horizontal_view.line_up(height - seen.height, camera) == pytest.approx(reached[1])
        assert low < reached[1] - CONFIG.search + 1e-9
        assert reached[1] + CONFIG.search - 1e-9 < high
    assert grid.left < -epal.width / 2


def test_an_edge_on_the_plane_is_where_it_is_and_a_higher_one_farther() -> None:
    camera = np.array([0.2, -2.0, 1.8])
    assert horizontal_view.line_up(0.0, camera) == 0.0
    assert horizontal_view.line_up(0.1, camera) > 0.05
    assert horizontal_view.line_up(-0.1, camera) < -0.05


def test_a_place_farther_on_the_ray_gives_a_similar_picture(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    places = ((1.0, POSE), (1.05, slid(shot, POSE, 1.05)))
    points = np.array([[0.3, 0.05, 0.0], [-0.4, -0.05, 0.0], [0.0, 0.1, 0.0]])
    near, far = (
        shot.camera.project(viewed(shot, t11, pose).view.camera_from_plane.apply(scale * points))
        for scale, pose in places
    )
    np.testing.assert_allclose(far.pixels, near.pixels, atol=1e-6)


# Boundary lines in such a view.

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
def test_a_boundary_is_found_to_a_pixel_over_its_length(two_region: bool, turn_deg: float, up: float) -> None:
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
def test_a_mirrored_view_has_the_opposite_turn_and_colour_is_read_as_well_as_gray(two_region: bool) -> None:
    view = half_planes(np.radians(4.0), 0.01)
    mirrored = PlaneView(view.image[:, ::-1].copy(), view.valid, GRID, view.camera_from_plane)
    here, there = lines_of(view, two_region)[0], lines_of(mirrored, two_region)[0]
    assert here.turn > 0 > there.turn
    assert there.turn == pytest.approx(-here.turn, abs=2 * (STEP + GRID.resolution / 1.2))
    assert there.up == pytest.approx(here.up, abs=1.5 * GRID.resolution)
    gray = half_planes(np.radians(2.0), 0.0)
    colour = PlaneView(np.dstack([gray.image] * 3), gray.valid, GRID, gray.camera_from_plane)
    assert lines_of(colour, two_region) == lines_of(gray, two_region)


@METHODS
def test_a_plain_view_or_what_is_not_seen_or_turned_too_far_gives_no_line(two_region: bool) -> None:
    assert lines_of(view_of(np.full((GRID.rows, GRID.columns), 120.0), noise=0.0), two_region) == []
    lines = boundary_lines(half_planes(np.radians(9.0), 0.01), two_region, np.radians(3.0), STEP)
    assert all(abs(line.turn) <= np.radians(3.0) + STEP for line in lines)
    assert all(line.votes < 0.7 * GRID.columns for line in lines)
    unseen = half_planes(0.0, 0.01)
    seen = np.broadcast_to(np.arange(GRID.columns) < 0.2 * GRID.columns, unseen.valid.shape)
    assert lines_of(PlaneView(unseen.image, seen, GRID, unseen.camera_from_plane), two_region) == []


def test_edges_find_several_lines_the_longest_first_and_two_regions_the_nearest() -> None:
    long = 80.0 * shares(np.radians(-1.0), -0.05)
    short = 80.0 * shares(np.radians(3.0), 0.06)
    short[:, : GRID.columns // 2] = short[0, 0]
    lines = lines_of(view_of(40.0 + long + short), two_region=False)
    assert [line.votes for line in lines] == sorted((line.votes for line in lines), reverse=True)
    assert lines[0].turn == pytest.approx(np.radians(-1.0), abs=2 * STEP)
    assert any(abs(line.turn - np.radians(3.0)) < 3 * STEP and abs(line.up - 0.06) < 0.008 for line in lines)
    levels = 170.0 - 100.0 * shares(np.radians(1.0), -0.04) + 100.0 * shares(np.radians(1.0), 0.08)
    best = lines_of(view_of(levels), two_region=True)[0]
    assert best.up == pytest.approx(-0.04, abs=2 * GRID.resolution)
