from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from palletloc import LevelPose, PalletModel, Shot
from palletloc.cameras import CameraModel, Equirectangular, KannalaBrandt, Pinhole
from palletloc.face import face_edges
from palletloc.geometry import FloatArray, wrap_angle
from palletloc.measurement import Reason
from palletloc.pallet_library import load_library
from palletloc.refinement.hypotheses import SearchConfig
from palletloc.refinement.patch import FacePatch
from palletloc.refinement.samples import LEVEL_SPACING, face_samples
from palletloc.refinement.search import Search, search
from tests.palletloc.poses import FLOOR, POSE, Height, Photograph, Portrait, blanked

FAR = SearchConfig(turn_deg=24.0, nearer=0.9, farther=0.9)
NEAR = SearchConfig()
PINHOLE = Pinhole(720, 540, 480.0, 480.0, 359.5, 269.5)
FISHEYE = KannalaBrandt(800, 640, 420.0, 420.0, 399.5, 319.5, k1=0.02, k2=-0.004, max_angle=1.6)
SPHERE = Equirectangular(2560, 1280)
CENTER = (0.3, -0.08, 1.85)
LEFT, RIGHT = np.pi / 2, -np.pi / 2

FLOOR_SCENES = [
    (PINHOLE, "t11", LevelPose(0.9, 2.0, 0.0, LEFT + 0.03), 1),
    (PINHOLE, "epal", LevelPose(-0.2, -2.2, 0.0, RIGHT - 0.04), 2),
    (FISHEYE, "open_below", LevelPose(0.6, 2.3, 0.0, LEFT - 0.02), 3),
    (FISHEYE, "t11", LevelPose(1.0, -1.9, 0.0, RIGHT + 0.05), 4),
]
MORE_SCENES = [
    (camera, name, LevelPose(x, side * y, 0.0, side * LEFT + turn), seed)
    for seed, (camera, name, x, y, side, turn) in enumerate(
        [
            (SPHERE, "epal", 0.9, 2.0, 1, 0.03),
            (SPHERE, "open_below", -0.6, 2.4, -1, -0.05),
            (SPHERE, "t11", 1.5, 1.8, 1, 0.02),
            (SPHERE, "t11", 1.3, 2.6, -1, 0.0),
            (SPHERE, "open_below", 0.3, 2.0, 1, 0.04),
            (SPHERE, "epal", -0.4, 1.7, -1, -0.03),
        ],
        10,
    )
]
OFFSETS = [(turn, along) for turn in (-20.0, 20.0) for along in (-0.3, 0.8)] + [(0.0, 0.8), (20.0, 0.0), (-12.0, 0.4)]


def aimed(photograph: Photograph, camera: CameraModel, model: PalletModel, pose: LevelPose, seed: int) -> Shot:
    """Take a picture of a pallet; a camera that does not see all around looks at it."""
    x, y, z = np.array([pose.x, pose.y, 0.3]) - CENTER
    aim = [1.5, 0.9] if camera.period_px else np.degrees([np.arctan2(y, x), np.arctan2(-z, np.hypot(x, y))]).tolist()
    return photograph(((model, pose),), camera, (*CENTER, *aim, 0.8), seed=seed)


def off(shot: Shot, pose: LevelPose, turn_deg: float, along: float) -> LevelPose:
    """A start turned against a pose and farther along the level viewing direction."""
    ray = np.array([pose.x, pose.y]) - shot.mounting.center[:2]
    x, y = np.array([pose.x, pose.y]) + along * ray / np.linalg.norm(ray)
    return replace(pose, x=float(x), y=float(y), yaw=float(pose.yaw + np.radians(turn_deg)))


def looked(
    shot: Shot, start: LevelPose, model: PalletModel, height: Height = FLOOR, config: SearchConfig = FAR
) -> Search | Reason:
    return search(shot, start, model, height, config)


def apart(pose: LevelPose, other: LevelPose) -> tuple[float, float]:
    """The distance in metres and the angle in degrees between two poses."""
    difference = pose.minus(other)
    return float(np.linalg.norm(difference[:3])), abs(float(np.degrees(difference[3])))


def missed(
    shot: Shot, model: PalletModel, pose: LevelPose, offsets: list[tuple[float, float]] = OFFSETS
) -> list[str]:
    """Tell from which starts neither of the first two places is the pallet's."""
    lost = []
    for turn_deg, along in offsets:
        found = looked(shot, off(shot, pose, turn_deg, along), model)
        if isinstance(found, Reason):
            lost.append(f"{turn_deg} deg, {along} m: {found}")
            continue
        away = [apart(start, pose) for start, _ in found.starts[:2]]
        if not any(metres < 0.08 and degrees < 4.0 for metres, degrees in away):
            lost.append(f"{turn_deg} deg, {along} m: {np.round(away, 2).tolist()}")
    return lost


@pytest.mark.parametrize(("camera", "model", "pose", "seed"), FLOOR_SCENES, indirect=["model"])
def test_far_starts_lead_to_the_pallet_by_the_first_or_second_place(
    camera: CameraModel, model: PalletModel, pose: LevelPose, seed: int, photograph: Photograph
) -> None:
    assert missed(aimed(photograph, camera, model, pose, seed), model, pose) == []


@pytest.mark.slow
@pytest.mark.parametrize(("camera", "model", "pose", "seed"), MORE_SCENES, indirect=["model"])
def test_far_starts_lead_to_the_pallet_in_pictures_from_all_around(
    camera: CameraModel, model: PalletModel, pose: LevelPose, seed: int, photograph: Photograph
) -> None:
    shot = aimed(photograph, camera, model, pose, seed)
    every = [(turn, along) for turn in (-20.0, -10.0, 0.0, 10.0, 20.0) for along in (-0.3, 0.0, 0.4, 0.8)]
    assert missed(shot, model, pose, every) == []


@pytest.mark.parametrize(("turn_deg", "along"), [(0.0, 0.0), (4.0, 0.06), (-4.0, -0.06)])
def test_near_starts_lead_there_at_once(turn_deg: float, along: float, portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    found = looked(shot, off(shot, POSE, turn_deg, along), epal, config=NEAR)
    assert isinstance(found, Search)
    metres, degrees = apart(found.starts[0][0], POSE)
    assert metres < 0.03
    assert degrees < 2.5


def test_on_a_known_level_every_place_is_on_it_whatever_the_start_says(portrait: Portrait, t11: PalletModel) -> None:
    found = looked(portrait(t11, POSE), replace(POSE, z=0.04), t11, config=NEAR)
    assert isinstance(found, Search)
    assert {start.z for start, _ in found.starts} == {0.0}


@pytest.mark.parametrize("rise", [-0.04, 0.04])
def test_without_a_level_the_viewing_ray_is_found(rise: float, portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    found = looked(shot, replace(POSE, z=rise), epal, None, NEAR)
    assert isinstance(found, Search)
    ray = POSE.as_array()[:3] - shot.mounting.center
    across = []
    for start, _ in found.starts:
        difference = start.as_array()[:3] - POSE.as_array()[:3]
        across.append(float(np.linalg.norm(difference - (difference @ ray) / (ray @ ray) * ray)))
    assert min(across[:2]) < 0.03


def test_places_come_the_best_first_each_with_a_view_of_all_the_face(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    half, high = t11.width / 2, t11.height
    corners = np.array([[-half, 0.0], [half, 0.0], [-half, high], [half, high]])
    for config in (NEAR, replace(NEAR, turn_deg=15.0, nearer=0.3, farther=0.3)):
        found = looked(shot, POSE, t11, config=config)
        assert isinstance(found, Search)
        for start, patch in found.starts:
            assert isinstance(patch, FacePatch)
            grid = patch.view.grid
            at = grid.pixels(patch.appearing(start, corners))
            assert (at > 0).all()
            assert (at < [grid.columns - 1, grid.rows - 1]).all()
    found = looked(shot, POSE, t11, config=NEAR)
    assert isinstance(found, Search)
    scores = [peak.score for peak in found.found.peaks]
    assert scores == sorted(scores, reverse=True)
    assert len(found.starts) >= 1


@pytest.mark.parametrize("height", [FLOOR, None], ids=["level", "free"])
def test_it_looks_as_far_as_it_is_told(height: Height, floor_shot: Shot, t11: PalletModel) -> None:
    config = SearchConfig(turn_deg=11.0, nearer=0.2, farther=0.5, sideways=0.03, upward=0.05)
    found = looked(floor_shot, POSE, t11, height, config)
    assert isinstance(found, Search)
    grid = found.found.grid
    away = float(np.linalg.norm(np.array([POSE.x, POSE.y]) - floor_shot.mounting.center[:2]))
    np.testing.assert_allclose(np.degrees(grid.turns[[0, -1]]), [-11.0, 11.0])
    np.testing.assert_allclose((grid.ranges[[0, -1]] - 1) * away, [-0.2, 0.5], atol=1e-6)
    np.testing.assert_allclose(grid.places[[0, -1]], [-0.03, 0.03])
    np.testing.assert_allclose(grid.rises[[0, -1]], [0.0, 0.0] if height else [-0.05, 0.05])
    assert grid.sliding is (height is None)


@pytest.mark.parametrize("fill", [0, 90, 255])
def test_a_plain_image_has_no_peak(fill: int, portrait: Portrait, t11: PalletModel) -> None:
    assert looked(blanked(portrait(t11, POSE), fill), POSE, t11) is Reason.NO_PEAK


def test_from_behind_and_out_of_the_image_there_is_nothing_to_look_at(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    assert looked(shot, replace(POSE, yaw=RIGHT), t11) is Reason.BEHIND_FACE
    assert looked(shot, replace(POSE, x=0.3, y=0.05), t11) is Reason.BEHIND_FACE
    assert looked(shot, replace(POSE, x=4.5), t11) is Reason.OUT_OF_VIEW
    assert looked(shot, LevelPose(0.3, -2.5, 0.0, RIGHT), t11) is Reason.OUT_OF_VIEW


@pytest.mark.parametrize("turn_deg", [24.0, -24.0])
def test_however_near_the_camera_a_start_lies_the_search_ends_with_a_result_or_a_reason(
    turn_deg: float, rack_shot: Shot, t11: PalletModel
) -> None:
    x, y, z = rack_shot.mounting.center.tolist()
    for away in (0.21, 0.5, 1.5):
        for up in (-z, -0.1, 0.5):
            start = LevelPose(x + 0.3, y + away, z + up, LEFT + float(np.radians(turn_deg)))
            assert isinstance(looked(rack_shot, start, t11, None, FAR), Search | Reason)


@pytest.mark.parametrize("side", [LEFT, -LEFT, np.pi - 0.02])
def test_nothing_is_looked_for_beyond_the_yaws_that_may_be(side: float, portrait: Portrait, t11: PalletModel) -> None:
    ahead = np.array([np.cos(side), np.sin(side)])
    pose = LevelPose(0.3 + 2.2 * float(ahead[0]), -0.08 + 2.2 * float(ahead[1]), 0.0, side)
    shot, reach = portrait(t11, pose), np.radians(2.0)
    start = replace(pose, yaw=float(wrap_angle(pose.yaw + np.radians(1.5))))
    where = shot, start, t11, FLOOR, NEAR
    narrow = search(*where, (float(wrap_angle(pose.yaw - reach)), float(wrap_angle(pose.yaw + reach))))
    assert isinstance(narrow, Search)
    turns = start.yaw + narrow.found.grid.turns - pose.yaw
    assert np.abs(wrap_angle(turns)).max() <= reach + 1e-9
    assert np.ptp(turns) == pytest.approx(2 * reach)
    metres, degrees = apart(narrow.starts[0][0], pose)
    assert metres < 0.05
    assert degrees < 2.0


def test_a_start_beyond_the_yaws_that_may_be_is_looked_at_as_far_as_any(portrait: Portrait, t11: PalletModel) -> None:
    pose = LevelPose(0.9, 2.0, 0.0, LEFT)
    where = portrait(t11, pose), pose, t11, FLOOR, NEAR
    free, elsewhere = search(*where), search(*where, (0.0, 0.2))
    assert isinstance(free, Search)
    assert isinstance(elsewhere, Search)
    assert np.array_equal(free.found.grid.turns, elsewhere.found.grid.turns)


# The points that are looked at.


def distances(points: FloatArray, model: PalletModel, horizontal: bool) -> FloatArray:
    """The distance of each point from each edge of a direction, (points, edges)."""
    edges = [edge for edge in face_edges(model) if edge.horizontal is horizontal]
    starts, ends = np.array([edge.start for edge in edges]), np.array([edge.end for edge in edges])
    nearest = np.clip(points[:, None], starts, ends)  # edges run along the axes
    return np.asarray(np.linalg.norm(points[:, None] - nearest, axis=-1))


def test_the_weights_of_all_edges_add_up_and_each_edge_has_points_on_it_alone(model: PalletModel) -> None:
    samples = face_samples(model)
    assert samples.level_weight.sum() + samples.upright_weight.sum() == pytest.approx(1.0)
    assert samples.level_weight.min() > 0
    assert samples.upright_weight.min() > 0
    for points, weight in (
        (samples.level, samples.level_weight),
        (samples.upright, samples.upright_weight),
        (samples.block, samples.block_weight),
    ):
        assert points.shape == (len(weight), 2)
    for horizontal, points in ((True, samples.level), (False, samples.upright)):
        away = distances(points, model, horizontal)
        assert away.min(axis=1).max() < 1e-12
        assert away.min(axis=0).max() < 1e-12


def test_points_are_dense_and_their_weight_is_spread_by_length(model: PalletModel) -> None:
    level = face_samples(model).level
    for edge in face_edges(model):
        if edge.horizontal:
            mine = level[np.isclose(level[:, 1], edge.start[1])]
            mine = mine[(mine[:, 0] > edge.start[0]) & (mine[:, 0] < edge.end[0])]
            gaps = np.diff([edge.start[0], *np.sort(mine[:, 0]), edge.end[0]])
            assert gaps.max() < 1.6 * LEVEL_SPACING
    samples = face_samples(model)
    for horizontal, points, weight in (
        (True, samples.level, samples.level_weight),
        (False, samples.upright, samples.upright_weight),
    ):
        edges = [edge for edge in face_edges(model) if edge.horizontal is horizontal]
        owner = distances(points, model, horizontal).argmin(axis=1)
        share = np.bincount(owner, weight, len(edges)) / np.array([edge.length for edge in edges])
        np.testing.assert_allclose(share, share[0], rtol=1e-9)


def test_points_in_every_block_lie_in_the_solid_off_its_edges_and_count_against_a_pose(model: PalletModel) -> None:
    samples = face_samples(model)
    assert len(samples.block) > 0 or max(right - left for left, right in model.blocks) < 0.04
    assert (samples.block_weight < 0).all()
    assert samples.block_weight.sum() > -1.0
    for right, up in samples.block:
        assert abs(right) < model.width / 2
        assert 0.0 < up < model.height
        assert not any(o.left <= right <= o.right and o.bottom <= up <= o.top for o in model.openings)
    for horizontal in (True, False):
        assert distances(samples.block, model, horizontal).min(initial=1.0) > 0.01
    block = face_samples(model).block[:, 0]
    for left, right in model.blocks:
        if len(block) and right - left > 0.05:
            assert ((block > left) & (block < right)).any()


@pytest.mark.parametrize(
    "law",
    [
        test_the_weights_of_all_edges_add_up_and_each_edge_has_points_on_it_alone,
        test_points_are_dense_and_their_weight_is_spread_by_length,
        test_points_in_every_block_lie_in_the_solid_off_its_edges_and_count_against_a_pose,
    ],
)
def test_it_holds_for_every_pallet_of_the_library(law: Callable[[PalletModel], None]) -> None:
    for each in load_library().values():
        law(each)


def test_what_is_shared_cannot_be_written(t11: PalletModel) -> None:
    samples = face_samples(t11)
    assert face_samples(t11) is samples
    for array in (samples.level, samples.upright, samples.block, samples.level_weight, samples.block_weight):
        assert not array.flags.writeable
