"""A textured front with gaps before a textured back wall, drawn by casting rays."""

from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.drive import compose
from calibration.shelf.plane import Foot, PlaneEstimate, fuse
from calibration.shelf.plane_sweep import REACH, SIGMA, SWEEP, PlaneSweep, judged, sweep_estimate, sweep_plane
from palletloc.cameras import Equirectangular
from palletloc.geometry import FloatArray
from palletloc.io.recording import Recording
from palletloc.shelf import ShelfPlane
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
def swept(tmp_path: Path, recorded: Callable[..., Recording]) -> Swept:
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
