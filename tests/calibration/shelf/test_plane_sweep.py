"""Fronts of shelves drawn by casting rays: textured walls with gaps, a beam, and tags on uprights."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.drive import compose
from calibration.shelf.beam_line import BeamSearch, beam_lines
from calibration.shelf.plane import Foot, PlaneEstimate, fuse
from calibration.shelf.plane_sweep import REACH, SIGMA, SWEEP, PlaneSweep, judged, sweep_estimate, sweep_plane
from calibration.shelf.upright_tags import TagsOnUprights, tag_places, tag_plane
from calibration.targets.targets import SingleTag, TargetError
from palletloc.cameras import CameraModel, Equirectangular
from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.io.recording import Recording, ShotFile
from palletloc.pallet_library import find_models
from palletloc.shelf import ShelfPlane
from palletloc.trajectory import Trajectory
from tests.calibration.expecting import present

FRONT, BEHIND = 1.8, 0.9
TURN = float(np.radians(0.7))
CAMERA = Equirectangular(1280, 640)
MOUNTING = RigidTransform.from_components(
    [0.2, 0.05, 1.4], Rotation.from_euler("ZYX", [1.5, -1.0, 0.8], degrees=True)
)
POSES = np.stack([np.linspace(0, 1.6, 4), [0.0, 0.02, 0.01, 0.0], 0.01 * np.arange(4)], axis=1)
FOOT = Foot(np.array([0.9, 0.05]), np.pi / 2)
INTO = np.array([-np.sin(TURN), np.cos(TURN)])
CELL = 0.02
Swept = Callable[..., PlaneSweep]


def recorded(
    folder: Path, camera: CameraModel, mounting: RigidTransform, poses: FloatArray, shelf: ShelfPlane,
    pictures: Iterable[FloatArray | Image],
) -> Recording:  # fmt: skip
    """Write pictures, taken at poses in odom a second apart, and return their recording."""
    files = []
    for i, picture in enumerate(pictures):
        cv2.imwrite(str(folder / f"{i}.png"), np.asarray(picture).round().astype(np.uint8))
        files.append(ShotFile(float(i), f"{i}.png"))
    way = Trajectory(np.arange(float(len(poses))), *poses.T)
    return Recording(folder, camera, mounting, shelf, find_models(("epal1-1200",), {}), tuple(files), way)


def shifted(distance: float) -> float:
    """Return the distance from the foot's point of a plane that lies at a distance from odom's origin."""
    return distance - float(FOOT.point @ INTO)


def drawn(
    pose: FloatArray, layers: Sequence[tuple[float, float]], sigma: float, rng: np.random.Generator
) -> FloatArray:
    """Return a shot of walls, (distance, part of it that is there) each, near ones first; the last one is whole."""
    rows, columns = np.mgrid[: CAMERA.height, : CAMERA.width].astype(np.float64)
    rays = MOUNTING.rotation.apply(CAMERA.unproject(np.stack([columns, rows], -1)).directions.reshape(-1, 3))
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    rays[:, :2] = rays[:, :2] @ [[cos, sin], [-sin, cos]]
    seen = rays @ [*INTO, 0.0] > 0.3
    rays = rays[seen] / (rays[seen] @ [*INTO, 0.0])[:, None]
    center = compose(pose, np.array([*MOUNTING.translation[:2], 0.0]))[:2]
    light = np.zeros(len(rays))
    for k, (distance, part) in reversed(list(enumerate(layers))):
        texture = np.random.default_rng(k).uniform(30, 220, (400, 900)).astype(np.float32)
        reach = distance - center @ INTO
        right = (center + reach * rays[:, :2]) @ [INTO[1], -INTO[0]]
        up = MOUNTING.translation[2] + reach * rays[:, 2]
        column, row = ((c / CELL + first).astype(np.float32).reshape(-1, 1) for c, first in ((right, 450), (up, 100)))
        parts = [
            cv2.remap(texture, column[i : i + 30000], row[i : i + 30000], cv2.INTER_LINEAR, borderValue=(100.0,))
            for i in range(0, len(rays), 30000)
        ]
        light = np.where(np.mod(right, 0.5) < 0.5 * part, np.concatenate(parts)[:, 0], light)
    shot = np.full(len(seen), 100.0)
    shot[seen] = light
    return np.clip(shot + sigma * rng.standard_normal(len(shot)), 0, 255).reshape(CAMERA.height, CAMERA.width)


@pytest.fixture
def swept(tmp_path: Path) -> Swept:
    """Return what sweeps a plane at a distance from odom's origin through shots of walls."""

    def sweep(
        layers: Sequence[tuple[float, float]], distance: float, sigma: float = 2.0, poses: FloatArray = POSES
    ) -> PlaneSweep:
        rng = np.random.default_rng(7)
        shelf, pictures = ShelfPlane(0.0, FRONT, -np.pi / 2), (drawn(pose, layers, sigma, rng) for pose in poses)
        recording = recorded(tmp_path, CAMERA, MOUNTING, poses, shelf, pictures)
        return sweep_plane(recording, range(len(poses)), poses, FOOT, TURN, shifted(distance))

    return sweep


@pytest.mark.parametrize(
    ("off", "sigma"),
    [pytest.param(0.0, 2.0, marks=pytest.mark.slow), pytest.param(0.08, 2.0, marks=pytest.mark.slow), (-0.07, 6.0)],
)
def test_the_front_is_found_before_a_wall_that_fills_most_of_the_view(off: float, sigma: float, swept: Swept) -> None:
    found = swept([(FRONT, 0.4), (FRONT + BEHIND, 1.0)], FRONT + off, sigma)
    assert found.refusal is None
    assert found.peaks[0].distance == pytest.approx(shifted(FRONT), abs=0.005)


def test_the_wall_alone_gives_no_distance(swept: Swept) -> None:
    assert swept([(FRONT + BEHIND, 1.0)], FRONT).refusal == "sweep_flat"


def test_a_plane_outside_the_window_is_not_moved_into_it(swept: Swept) -> None:
    found = swept([(FRONT, 1.0)], FRONT - REACH - 0.005)
    assert found.refusal == "sweep_at_edge"


def test_two_planes_that_show_alike_are_both_named_and_neither_is_taken(swept: Swept) -> None:
    found = swept([(FRONT - 0.07, 0.42), (FRONT + 0.07, 1.0)], FRONT)
    assert found.refusal == "sweep_ambiguous"
    near, far = sorted(peak.distance for peak in found.peaks[:2])
    assert [near, far] == pytest.approx([shifted(FRONT - 0.07), shifted(FRONT + 0.07)], abs=0.01)


def test_shots_without_a_baseline_give_no_distance(swept: Swept) -> None:
    near = np.stack([np.linspace(0, 0.1, 3), np.zeros(3), np.zeros(3)], axis=1)
    found = swept([(FRONT, 1.0)], FRONT, poses=near)
    assert (found.windows, found.peaks, found.refusal) == (0, (), "sweep_flat")


def bell(*tops: tuple[float, float], floor: float = 0.01) -> tuple[FloatArray, FloatArray]:
    """Return distances and scores with a peak at each place of a height."""
    distances: FloatArray = 1.8 + 0.01 * np.arange(-15, 16, dtype=np.float64)
    scores = np.full(31, floor)
    for at, high in tops:
        scores += high * np.exp(-(((distances - at) / 0.015) ** 2) / 2)
    return distances, scores


def test_a_lone_peak_lies_at_the_top_of_its_parabola() -> None:
    found = judged(*bell((1.8234, 0.3)), 1000)
    assert (found.refusal, len(found.peaks)) == (None, 1)
    assert found.peaks[0].distance == pytest.approx(1.8234, abs=0.001)


@pytest.mark.parametrize(
    ("tops", "windows", "refusal"),
    [
        ([(1.82, 0.3), (1.72, 0.19)], 1000, None),
        ([(1.82, 0.3), (1.72, 0.23)], 1000, "sweep_ambiguous"),
        ([(1.82, 0.3), (1.65, 0.25)], 1000, "sweep_ambiguous"),
        ([(1.95, 0.3)], 1000, "sweep_at_edge"),
        ([(1.97, 0.3)], 1000, "sweep_at_edge"),
        ([(1.82, 0.005)], 1000, "sweep_flat"),
        ([(1.82, 0.3)], 50, "sweep_flat"),
        ([], 1000, "sweep_flat"),
    ],
)
def test_only_a_clear_peak_is_taken(tops: list[tuple[float, float]], windows: int, refusal: str | None) -> None:
    assert judged(*bell(*tops), windows).refusal == refusal


def peaked(at: float, width: float) -> PlaneSweep:
    """Return a sweep with one peak."""
    distances: FloatArray = 1.8 + 0.01 * np.arange(-15, 16, dtype=np.float64)
    return judged(distances, 0.02 + 0.3 * np.exp(-0.5 * ((distances - at) / width) ** 2), 900)


def said(method: str, distance: float, sigma: float) -> PlaneEstimate:
    return PlaneEstimate(method, 0.0, distance, np.diag([1e6, sigma**-2]), "")


def test_a_clear_peak_is_as_sure_as_the_planes_stand_together_and_it_is_narrow() -> None:
    apart = [said("uprights", 1.8, 0.01), said("beams", 1.86, 0.01)]
    close = [said("uprights", 1.8, 0.01), said("pallets", 1.83, 0.01)]
    found = {
        name: sweep_estimate(peaked(1.82, width), 0.0, others)
        for name, width, others in (
            ("apart", 0.015, apart),
            ("close", 0.015, close),
            ("wide", 0.04, close),
            ("alone", 0.015, apart[:1]),
        )
    }
    sigma = {name: estimate.sigma[1] for name, estimate in found.items() if estimate is not None}
    assert 0.06 < sigma["apart"] < 0.075
    assert 0.03 < sigma["close"] < 0.045
    assert sigma["wide"] > 1.2 * sigma["close"]
    assert sigma["alone"] > SIGMA


def test_a_sweep_says_nothing_of_the_heading_and_nothing_without_a_clear_peak() -> None:
    others = [said("uprights", 1.8, 0.01)]
    found = present(sweep_estimate(peaked(1.82, 0.015), 0.01, others))
    assert np.isinf(found.sigma[0])
    fused = present(fuse([*others, found]))
    assert fused.turn == pytest.approx(0.0, abs=1e-9)
    assert 1.8 < fused.distance < 1.802
    assert sweep_estimate(peaked(1.95, 0.015), 0.0, others) is None


def test_a_sweep_that_contradicts_the_others_is_named() -> None:
    others = [said("uprights", 1.8, 0.003), said("pallets", 1.81, 0.003)]
    found = present(sweep_estimate(peaked(1.91, 0.012), 0.0, others))
    fused = present(fuse([*others, found]))
    assert fused.disagreement is not None
    assert SWEEP in (fused.disagreement.first, fused.disagreement.second)


LEVEL, HEIGHT, BEAM_FRONT = 1.2, 0.12, 1.9
BEAM_TURN = float(np.radians(0.6))
BEAM_CAMERA = Equirectangular(1920, 960)
BEAM_MOUNTING = RigidTransform.from_components(
    [0.2, 0.05, 1.85], Rotation.from_euler("ZYX", [1.5, -1.0, 0.8], degrees=True)
)
BEAM_POSES = np.stack([np.linspace(0, 1.5, 4), np.zeros(4), 0.01 * np.arange(4)], axis=1)
NOBODY = np.zeros((0, 3))


def beam_shot(pose: FloatArray) -> FloatArray:
    """Return a shot of an orange beam, lighter than the wall behind it, with its top surface darker."""
    u, v = np.meshgrid(np.arange(1920.0), np.arange(960.0))
    rays = BEAM_MOUNTING.rotation.apply(BEAM_CAMERA.unproject(np.stack([u, v], -1)).directions.reshape(-1, 3))
    yaw = pose[2]
    x, y = np.cos(yaw) * rays[:, 0] - np.sin(yaw) * rays[:, 1], np.sin(yaw) * rays[:, 0] + np.cos(yaw) * rays[:, 1]
    center = compose(pose, np.array([*BEAM_MOUNTING.translation[:2], 0.0]))
    into = np.array([-np.sin(BEAM_TURN), np.cos(BEAM_TURN)])
    ahead = x * into[0] + y * into[1]
    distance = (BEAM_FRONT - center[:2] @ into) / np.where(ahead > 1e-6, ahead, np.inf)
    height = np.where(ahead > 1e-6, BEAM_MOUNTING.translation[2] + rays[:, 2] * distance, np.inf)
    edge = 0.004  # as wide as a pixel is there
    front = np.clip((LEVEL - height) / edge, -1, 1) + np.clip((height - LEVEL + HEIGHT) / edge, -1, 1)
    return np.asarray((90 + 45 * front).reshape(960, 1920))


@pytest.fixture(scope="module")
def beam(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    shelf = ShelfPlane(0.0, BEAM_FRONT, -np.pi / 2, (0.0, LEVEL))
    pictures = (beam_shot(pose) for pose in BEAM_POSES)
    return recorded(tmp_path_factory.mktemp("beam"), BEAM_CAMERA, BEAM_MOUNTING, BEAM_POSES, shelf, pictures)


BEAM_FOOT = Foot(np.array([0.9, 0.0]), np.pi / 2)
BEAM = BEAM_FOOT.described(
    ShelfPlane(-BEAM_FRONT * float(np.sin(BEAM_TURN)), BEAM_FRONT * float(np.cos(BEAM_TURN)), BEAM_TURN - np.pi / 2)
)


@pytest.mark.parametrize(("turn_deg", "off"), [(0.0, 0.0), (1.2, 0.03), (-0.3, -0.04)])
def test_the_front_edge_is_found_around_planes_that_are_off(beam: Recording, turn_deg: float, off: float) -> None:
    search = BeamSearch(BEAM_FOOT, float(np.radians(turn_deg)), BEAM[1] + off, 0.1, NOBODY)
    found = beam_lines(beam, range(4), BEAM_POSES, search)
    assert len(found) == 1
    assert found[0].distance == pytest.approx(BEAM[1], abs=0.006)
    assert np.degrees(found[0].turn - BEAM[0]) == pytest.approx(0.0, abs=0.15)


def test_a_beam_near_the_camera_s_height_says_nothing(beam: Recording) -> None:
    near = replace(beam, shelf=replace(beam.shelf, levels=(1.8,)))
    assert beam_lines(near, range(4), BEAM_POSES, BeamSearch(BEAM_FOOT, 0.0, BEAM[1], 0.1, NOBODY)) == []


def test_a_wrong_height_moves_the_edge_as_its_sigma_says(beam: Recording) -> None:
    wrong = replace(beam, shelf=replace(beam.shelf, levels=(LEVEL + 0.01,)))
    (found,) = beam_lines(wrong, range(4), BEAM_POSES, BeamSearch(BEAM_FOOT, 0.0, BEAM[1], 0.1, NOBODY))
    assert 0.01 < abs(found.distance - BEAM[1]) < 2.5 * found.sigma[1]


def test_where_pallets_stand_nothing_is_looked_for(beam: Recording) -> None:
    everywhere = np.array([[-9.0, 9.0, LEVEL]])
    assert beam_lines(beam, range(4), BEAM_POSES, BeamSearch(BEAM_FOOT, 0.0, BEAM[1], 0.1, everywhere)) == []


TAGS_FRONT, TAGS_TURN = 1.8, float(np.radians(1.0))
TAGS = TagsOnUprights("DICT_4X4_50", 0.3, 0.01)
PLACES = {3: (-0.8, 1.3), 7: (1.0, 1.6)}
"""Middles along the shelf and heights."""
TAGS_POSES = np.array([[0.0, 0.0, 0.0], [0.4, 0.02, 0.03]])
TAGS_CAMERA = Equirectangular(1600, 800)
TAGS_FOOT = Foot(np.array([0.2, 0.0]), np.pi / 2)


def hung(place: float, height: float) -> RigidTransform:
    """Return ``odom_from_board`` of a tag before the front; its origin is the upper left corner, y is down."""
    shelf = Rotation.from_euler("z", TAGS_TURN)
    rotation = shelf * Rotation.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    corner = shelf.apply([place - TAGS.size / 2, TAGS_FRONT - TAGS.offset, 0.0]) + np.array(
        [0, 0, height + TAGS.size / 2]
    )
    return RigidTransform.from_components(corner, rotation)


@pytest.fixture(scope="module")
def tags_seen(
    tmp_path_factory: pytest.TempPathFactory, render: Callable[..., Image],
    forklift_from_camera: RigidTransform,
) -> Recording:  # fmt: skip
    def drawn(x: float, y: float, yaw: float) -> Image:
        camera_from_odom = (LevelPose(x, y, 0.0, yaw).transform() * forklift_from_camera).inv()
        tags = [
            (SingleTag(TAGS.size, TAGS.dictionary, number), camera_from_odom * hung(*place))
            for number, place in PLACES.items()
        ]
        return render(TAGS_CAMERA, tags)

    shelf, pictures = ShelfPlane(0.0, TAGS_FRONT, -np.pi / 2), (drawn(*pose) for pose in TAGS_POSES.tolist())
    return recorded(tmp_path_factory.mktemp("tags"), TAGS_CAMERA, forklift_from_camera, TAGS_POSES, shelf, pictures)


def test_tags_on_two_uprights_give_the_front_behind_them(tags_seen: Recording) -> None:
    places = tag_places(tags_seen, range(2), TAGS_POSES, TAGS)
    assert places.keys() == PLACES.keys()
    found = tag_plane(places, TAGS_FOOT, TAGS, TAGS_FRONT + 0.3)
    front = ShelfPlane(
        -TAGS_FRONT * float(np.sin(TAGS_TURN)), TAGS_FRONT * float(np.cos(TAGS_TURN)), TAGS_TURN - np.pi / 2
    )
    turn, distance = TAGS_FOOT.described(front)
    assert found is not None
    assert found.distance == pytest.approx(distance, abs=0.004)
    assert np.degrees(found.turn - turn) == pytest.approx(0.0, abs=0.2)


def test_an_unknown_dictionary_is_refused(tags_seen: Recording) -> None:
    with pytest.raises(TargetError):
        tag_places(tags_seen, range(1), TAGS_POSES, TagsOnUprights("DICT_9X9", 0.2))


def test_tags_elsewhere_do_not_count() -> None:
    far = {1: np.array([[0.0, 4.0]]), 2: np.array([[1.0, 4.0]])}
    assert tag_plane(far, TAGS_FOOT, TAGS, 1.8) is None
    assert tag_plane({}, TAGS_FOOT, TAGS) is None


def test_one_tag_tells_the_distance_but_hardly_the_heading() -> None:
    found = present(tag_plane({1: np.array([[0.2, 1.8]])}, TAGS_FOOT, TAGS))
    assert found.distance == pytest.approx(1.81, abs=1e-6)
    assert np.degrees(found.sigma[0]) > 3
