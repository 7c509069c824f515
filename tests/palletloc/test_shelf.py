from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

from palletloc import CameraModel, LevelPose, Mounting, PalletLocError, PalletModel, ShelfPlane, Shot
from palletloc.geometry import level_pose, wrap_angle
from palletloc.matching import edge_energy
from palletloc.plane import PlaneGrid
from palletloc.shelf_search import Sites, Steps, first_steps, refine, search, spaced
from palletloc.shelf_view import DetectionConfig, ShelfPlaneError, ShelfView, view_shelf
from palletloc.template import FacePlacement, TemplatePiece, face_template, match_template
from tests.palletloc.poses import Draw, Mounted

metres = st.floats(-20.0, 20.0)
angles = st.floats(-3.1, 3.1)
shelves = st.builds(ShelfPlane, metres, metres, angles)
forklifts = st.builds(LevelPose, metres, metres, st.just(0.0), angles)


def normal(shelf: ShelfPlane) -> np.ndarray:
    return np.array([np.cos(shelf.facing), np.sin(shelf.facing), 0.0])


@given(shelves, forklifts)
def test_the_seen_plane_is_the_same_plane(shelf: ShelfPlane, odom_from_forklift: LevelPose) -> None:
    seen = shelf.seen_from(odom_from_forklift)
    transform = odom_from_forklift.transform()
    point = transform.apply(np.array([seen.x, seen.y, 0.0]))
    np.testing.assert_allclose(point, [shelf.x, shelf.y, 0.0], atol=1e-9)
    np.testing.assert_allclose(transform.rotation.apply(normal(seen)), normal(shelf), atol=1e-9)


@given(shelves)
def test_from_the_origin_the_plane_is_as_given(shelf: ShelfPlane) -> None:
    seen = shelf.seen_from(LevelPose(0.0, 0.0, 0.0, 0.0))
    assert (seen.x, seen.y) == (shelf.x, shelf.y)
    assert seen.facing == pytest.approx(shelf.facing)


@given(shelves, forklifts, forklifts)
def test_going_on_is_the_same_as_going_at_once(shelf: ShelfPlane, first: LevelPose, second: LevelPose) -> None:
    at_once = shelf.seen_from(level_pose(first.transform() * second.transform()))
    in_turn = shelf.seen_from(first).seen_from(second)
    np.testing.assert_allclose([in_turn.x, in_turn.y], [at_once.x, at_once.y], atol=1e-8)
    assert wrap_angle(in_turn.facing - at_once.facing) == pytest.approx(0.0, abs=1e-9)


@given(shelves)
def test_a_straight_pallet_looks_into_the_shelf(shelf: ShelfPlane) -> None:
    assert -np.pi <= shelf.yaw < np.pi
    assert wrap_angle(shelf.yaw - shelf.facing - np.pi) == pytest.approx(0.0, abs=1e-9)


def test_levels_stay_and_the_drift_is_what_is_said() -> None:
    shelf = ShelfPlane(1.0, 2.0, -1.5, (0.0, 1.55), drift=0.5)
    moved = LevelPose(1.0, 0.0, 0.0, 0.2)
    assert shelf.seen_from(moved).levels == (0.0, 1.55)
    assert shelf.seen_from(moved).drift == 0.0
    assert shelf.seen_from(moved, drift=0.03).drift == 0.03


# Views of a shelf.

CONFIG = DetectionConfig()
SHELF = ShelfPlane(1.5, 2.0, -np.pi / 2 + 0.01, (0.0, 1.5))
Looking = Callable[..., ShelfView]


@pytest.fixture
def forklift_from_camera(mounted: Mounted) -> RigidTransform:
    return mounted(0.3, -0.1, 1.8, 3.0, 1.0, -0.5)


def gray(camera: CameraModel, forklift_from_camera: RigidTransform) -> Shot:
    return Shot(np.full((camera.height, camera.width), 100, np.uint8), camera, Mounting(forklift_from_camera))


@pytest.fixture
def looking(whole_view: CameraModel, t11: PalletModel, forklift_from_camera: RigidTransform) -> Looking:
    shot = gray(whole_view, forklift_from_camera)

    def view(shelf: ShelfPlane = SHELF, level: float | None = 0.0, config: DetectionConfig = CONFIG) -> ShelfView:
        levels = () if level is None else (level,)
        shelf = replace(shelf, levels=levels)
        (seen,) = view_shelf(shot, shelf, [t11], config)
        return seen

    return view


@pytest.mark.parametrize("facing", [-1.5, 1.6, 2.8])
def test_the_view_lies_on_the_plane_with_its_origin_beside_the_camera(
    facing: float, looking: Looking, forklift_from_camera: RigidTransform
) -> None:
    out = np.array([np.cos(facing), np.sin(facing), 0.0])
    center = forklift_from_camera.translation
    point = center - 2.2 * out + 0.7 * np.array([out[1], -out[0], 0.0])
    seen = looking(ShelfPlane(point[0], point[1], facing))
    plane = seen.forklift_from_plane
    for corner in ([-1.0, 0.3, 0.0], [2.0, 1.0, 0.0]):
        assert (plane.apply(corner) - point) @ out == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(plane.rotation.apply([0.0, 0.0, 1.0]), out, atol=1e-9)
    np.testing.assert_allclose(plane.translation, [*(center - 2.2 * out)[:2], 0.0], atol=1e-9)
    assert seen.distance == pytest.approx(2.2)
    assert seen.camera_height == pytest.approx(1.8)
    assert np.cos(seen.yaw - facing) == pytest.approx(-1.0)
    expected = forklift_from_camera.inv() * plane
    np.testing.assert_allclose(seen.view.camera_from_plane.as_matrix(), expected.as_matrix(), atol=1e-9)


@pytest.mark.parametrize("level", [0.0, 1.5, None])
def test_the_view_holds_every_face_that_is_searched(level: float | None, looking: Looking, t11: PalletModel) -> None:
    seen = looking(level=level)
    grid = seen.view.grid
    bottom = grid.top - (grid.rows - 1) * grid.resolution
    right = grid.left + (grid.columns - 1) * grid.resolution
    heights = (level, level) if level is not None else CONFIG.heights
    assert bottom < heights[0]
    assert grid.top > heights[1] + t11.height
    assert grid.left < seen.columns[0] - t11.width / 2
    assert right > seen.columns[1] + t11.width / 2


def test_what_is_searched_is_in_range_and_not_behind(looking: Looking, forklift_from_camera: RigidTransform) -> None:
    seen = looking()
    for column in seen.columns:
        away = seen.forklift_from_plane.apply([column, 0.0, 0.0]) - forklift_from_camera.translation
        assert np.hypot(*away[:2]) <= CONFIG.max_range + 1e-6
        assert abs(np.degrees(np.arctan2(away[1], away[0]))) <= CONFIG.max_bearing_deg + 3.0
    short = looking(config=replace(CONFIG, max_range=3.0))
    ahead = looking(config=replace(CONFIG, max_bearing_deg=95.0))
    assert np.ptp(short.columns) < np.ptp(seen.columns)
    assert np.ptp(ahead.columns) < np.ptp(seen.columns)


def test_a_shelf_on_the_other_side_is_searched_alike_and_drift_widens_the_band(looking: Looking) -> None:
    left, right = ShelfPlane(1.5, 1.9, -np.pi / 2), ShelfPlane(1.5, -2.1, np.pi / 2)
    there, here = looking(right), looking(left)
    assert there.distance == pytest.approx(here.distance)
    # ahead is to the right of a shelf on the left, and to the left of one on the right
    assert there.columns[0] == pytest.approx(-here.columns[1], abs=0.1)
    sure, unsure = looking(), looking(replace(SHELF, drift=np.radians(4.0)))
    assert unsure.view.grid.rows > sure.view.grid.rows
    assert unsure.drift == pytest.approx(np.radians(4.0))


def test_each_level_has_a_view_of_its_own_on_the_same_plane(
    whole_view: CameraModel, t11: PalletModel, forklift_from_camera: RigidTransform
) -> None:
    views = view_shelf(gray(whole_view, forklift_from_camera), SHELF, [t11], CONFIG)
    assert tuple(seen.level for seen in views) == SHELF.levels
    for seen in views:
        np.testing.assert_array_equal(seen.forklift_from_plane.as_matrix(), views[0].forklift_from_plane.as_matrix())
        assert seen.view.grid.rows < 200


def test_a_side_of_which_less_is_searched_takes_less_of_the_view(looking: Looking, t11: PalletModel) -> None:
    seen = looking(config=replace(CONFIG, max_bearing_deg=95.0))
    grid = seen.view.grid
    left = seen.columns[0] - grid.left - t11.width / 2
    right = grid.left + (grid.columns - 1) * grid.resolution - seen.columns[1] - t11.width / 2
    assert -seen.columns[0] < seen.columns[1]
    assert 0.1 < left < 0.5 * right


@pytest.mark.parametrize(
    ("shelf", "message"),
    [
        (ShelfPlane(0.3, -2.0, -np.pi / 2), "camera is behind the plane"),
        (ShelfPlane(1.5, 2.0, np.pi / 2), "camera is behind the plane"),
        (ShelfPlane(0.3, -0.1, -np.pi / 2), r"camera is -?0\.00 m from the plane"),
        (ShelfPlane(0.3, 0.1, -np.pi / 2), r"camera is 0\.20 m from the plane"),
    ],
    ids=["behind", "facing_away", "through", "grazing"],
)
def test_a_plane_that_the_camera_is_not_before_is_refused(shelf: ShelfPlane, message: str, looking: Looking) -> None:
    with pytest.raises(ShelfPlaneError, match=message) as caught:
        looking(shelf)
    assert isinstance(caught.value, PalletLocError)
    assert "\n" not in str(caught.value)
    assert "expected at least" in str(caught.value)


# The search on such a view.

RESOLUTION, DISTANCE, HEIGHT = 0.012, 2.1, 1.7
GRID = PlaneGrid.spanning(-1.8, 2.6, -0.7, 0.8, RESOLUTION)
CAMERA = np.array([0.0, HEIGHT, DISTANCE])
WINDOW = (33, 17)
Seen = tuple[ShelfView, list[TemplatePiece], Steps]
Shown = Callable[..., Seen]


@pytest.fixture
def shown(epal: PalletModel, draw_face: Draw) -> Shown:
    """Return a function that draws a face on the shelf: its place, depth behind the plane, yaw and height."""

    def drawn(place: float, depth: float, yaw: float = 0.0, height: float = 0.0, known: bool = True) -> Seen:
        view = draw_face(epal, GRID, CAMERA, (place, height), 1 + depth / DISTANCE, yaw)
        level = height if known else None
        seen = ShelfView(
            RigidTransform.identity(), 0.0, HEIGHT, DISTANCE, (-0.8, 1.4), 0.3, np.radians(1.0), level, view
        )
        config = replace(CONFIG, heights=(-0.05, 0.3))
        return (
            seen,
            face_template(epal, edge_energy(view.image, WINDOW), RESOLUTION),
            first_steps(seen, epal, config),
        )

    return drawn


@pytest.mark.parametrize(
    ("place", "depth", "yaw"), [(0.0, 0.0, 0.0), (0.73, 0.11, 0.05), (-0.51, -0.09, -0.06), (1.2, 0.2, 0.07)]
)
@pytest.mark.parametrize("known", [True, False])
def test_a_face_is_found_where_it_stands(place: float, depth: float, yaw: float, known: bool, shown: Shown) -> None:
    seen, template, steps = shown(place, depth, yaw, 0.06, known)
    sites = refine(seen, template, steps, search(seen, template, steps, CONFIG), 1.0, CONFIG)
    found = [values[sites.score.argmax()] for values in sites]
    assert found[0] == pytest.approx(place, abs=0.03 if known else 0.06)
    assert found[1] == pytest.approx(depth, abs=0.03 if known else 0.10)
    assert found[2] == pytest.approx(yaw, abs=0.03)
    assert found[3] == pytest.approx(0.06, abs=1e-9 if known else 0.06)
    assert found[4] > 0.7


def test_the_first_pass_scores_as_the_template_and_refining_loses_no_score(shown: Shown) -> None:
    seen, template, steps = shown(0.4, 0.05)
    sites = search(seen, template, steps, replace(CONFIG, min_score=-1.0))
    placement = FacePlacement(
        1 + sites.depth[:, None] / DISTANCE, np.zeros((len(sites.place), 1)), sites.height[:, None]
    )
    score = match_template(template, GRID, CAMERA, placement, np.zeros(1), sites.place[:, None])[:, 0]
    # the first pass rounds the pieces' places to pixels, and takes off something for the depth
    inside = score > 0.5
    assert inside.any()
    np.testing.assert_allclose(sites.score[inside], score[inside], atol=0.1)
    assert np.abs(sites.score - score).mean() < 0.06
    seen, template, steps = shown(0.73, 0.11, 0.05)
    first = search(seen, template, steps, CONFIG)
    second = refine(seen, template, steps, first, 1.0, CONFIG)
    assert len(second.place) == len(first.place)
    assert second.score.max() > first.score.max()
    assert (second.score >= first.score - 0.06).all()
    near = np.abs(second.depth - first.depth) <= np.diff(steps.scales)[0] * DISTANCE + 1e-9
    assert near.all()


def test_steps_are_as_fine_as_the_view_tolerates(shown: Shown, epal: PalletModel) -> None:
    seen, _, level = shown(0.0, 0.0)
    free = first_steps(replace(seen, level=None), epal, CONFIG)
    fine = first_steps(replace(seen, view=replace(seen.view, grid=replace(GRID, resolution=0.006))), epal, CONFIG)
    for steps in (level, free, fine):
        assert np.ptp(np.diff(steps.scales)) < 1e-9
        assert steps.scales.mean() == pytest.approx(1.0)
        assert steps.turn > np.radians(CONFIG.plane_yaw_deg + CONFIG.pallet_yaw_deg)
    assert np.diff(fine.scales)[0] == pytest.approx(np.diff(level.scales)[0] / 2, rel=0.1)
    # a face of free height does not move up or down with its distance
    assert np.diff(free.scales)[0] > 2 * np.diff(level.scales)[0]
    assert level.heights.tolist() == [0.0]
    assert free.heights[0] == pytest.approx(CONFIG.heights[0])
    assert free.heights[-1] > CONFIG.heights[1] - 0.05


def test_what_the_view_leaves_open_stays_near_the_nominal_plane_and_nothing_stays_nothing(shown: Shown) -> None:
    seen, template, steps = shown(0.3, 0.0)
    flat = [piece._replace(field=np.full_like(piece.field, 200)) for piece in template]
    sites = Sites(*(np.array([value]) for value in (0.3, 0.0, 0.0, 0.0, 0.0)))
    same = refine(seen, flat, steps, sites, 1.0, CONFIG)
    assert same.yaw[0] == pytest.approx(0.0, abs=1e-3)
    assert same.depth[0] == pytest.approx(0.0, abs=0.01)
    seen, template, steps = shown(0.0, 0.0)
    none = Sites(*(np.empty(0) for _ in range(5)))
    assert len(refine(seen, template, steps, none, 1.0, CONFIG).place) == 0


def test_the_best_of_what_stands_together_is_kept() -> None:
    rng = np.random.default_rng(0)
    sites = Sites(rng.uniform(0, 2, 300), rng.uniform(-0.2, 0.2, 300), *rng.uniform(0, 0.3, (3, 300)))
    kept = spaced(sites, sites.score, 1000, 0.144, CONFIG)
    assert kept[0] == sites.score.argmax()
    assert (np.diff(sites.score[kept]) <= 0).all()

    def near(i: int, j: int) -> bool:
        return bool(
            abs(sites.place[i] - sites.place[j]) < CONFIG.min_spacing
            and abs(sites.depth[i] - sites.depth[j]) < CONFIG.min_depth_spacing
            and abs(sites.height[i] - sites.height[j]) < 0.6 * 0.144
        )

    for rank, site in enumerate(kept):
        assert not any(near(site, other) for other in kept[:rank])
    for site in range(300):
        assert site in kept or any(near(site, other) and sites.score[other] >= sites.score[site] for other in kept)
    assert spaced(sites, sites.score, 5, 0.144, CONFIG).tolist() == kept[:5].tolist()
