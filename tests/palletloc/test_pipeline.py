from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from palletloc.baselines import horizontal_plane_for, measure_on_planes, nearest_line
from palletloc.cameras import CameraModel
from palletloc.candidate import Candidate, Fit, Refusal
from palletloc.config import LocalizerConfig
from palletloc.geometry import LevelPose
from palletloc.measurement import HeightPrior, Reason, Stage, YawSource
from palletloc.pallet import PalletModel
from palletloc.paper.boundary import BoundaryLine
from palletloc.shot import Shot

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
FLOOR = HeightPrior(0.0, 0.003)
CONFIG = LocalizerConfig()
Portrait = Callable[..., Shot]
Placed = tuple[PalletModel, LevelPose]


def measured(
    shot: Shot,
    model: PalletModel,
    start: LevelPose,
    height: HeightPrior | None,
    config: LocalizerConfig = CONFIG,
) -> Candidate:
    candidate = Candidate(model, start, height)
    measure_on_planes(shot, candidate, config)
    return candidate


def wrong(candidate: Candidate, truth: LevelPose) -> np.ndarray:
    assert candidate.pose is not None, candidate.refusal
    return candidate.pose.as_array() - truth.as_array()


@pytest.mark.parametrize("name", ["epal", "t11", "open_below"])
@pytest.mark.parametrize("height", [FLOOR, None], ids=["level", "free"])
def test_a_pallet_on_the_floor_is_measured_as_well_as_its_covariance_says(
    name: str, height: HeightPrior | None, portrait: Portrait, request: pytest.FixtureRequest
) -> None:
    model: PalletModel = request.getfixturevalue(name)
    start = LevelPose(POSE.x + 0.03, POSE.y + 0.02, 0.0, POSE.yaw - 0.03)
    candidate = measured(portrait(model, POSE), model, start, height)
    assert candidate.refusal is None
    assert candidate.covariance is not None
    error = wrong(candidate, POSE)
    assert error @ np.linalg.solve(candidate.covariance, error) < 25.0
    assert (np.abs(error) < 4 * np.sqrt(np.diag(candidate.covariance))).all()
    assert np.abs(error[:2]).max() < 0.03


def test_every_step_leaves_its_result(portrait: Portrait, t11: PalletModel) -> None:
    candidate = measured(portrait(t11, POSE), t11, replace(POSE, yaw=POSE.yaw + 0.03), FLOOR)
    assert candidate.lines
    assert len(candidate.horizontal) >= 2
    assert candidate.yaw is not None
    assert candidate.sweep is not None
    assert candidate.face is not None
    assert candidate.verification is not None
    assert candidate.pose == candidate.face.forklift_from_pallet
    assert candidate.yaw_from is candidate.yaw.source
    assert candidate.joint is None


@pytest.mark.parametrize("max_doubt", [CONFIG.face_fit.max_doubt, -1e6], ids=["certain", "never_certain"])
def test_the_last_horizontal_view_is_the_one_that_gave_the_yaw(
    max_doubt: float, floor_shot: Shot, floor_pallets: tuple[Placed, ...]
) -> None:
    config = replace(CONFIG, face_fit=replace(CONFIG.face_fit, max_doubt=max_doubt))
    for model, pose in floor_pallets:
        candidate = measured(floor_shot, model, replace(pose, x=pose.x + 0.05), None, config)
        assert candidate.yaw is not None
        last = candidate.horizontal[-1]
        placed = floor_shot.mounting.forklift_from_camera * last.view.camera_from_plane
        heading = placed.rotation.apply([0.0, 1.0, 0.0])
        used = [vote for vote in candidate.yaw.votes if vote.used]
        turn = np.average([vote.turn for vote in used], weights=[vote.sigma**-2 for vote in used])
        placed_yaw = float(np.arctan2(heading[1], heading[0]))
        assert candidate.yaw.yaw == pytest.approx(placed_yaw + turn, abs=1e-9)


@pytest.mark.parametrize("turn_deg", [-4.0, -2.0, 2.0, 4.0])
@pytest.mark.parametrize("slide", [-0.05, 0.05])
def test_any_start_near_the_pallet_leads_to_the_same_pose(
    turn_deg: float, slide: float, portrait: Portrait, t11: PalletModel
) -> None:
    shot = portrait(t11, POSE)
    into = np.array([np.cos(POSE.yaw), np.sin(POSE.yaw)])
    x, y = np.array([POSE.x, POSE.y]) + slide * into
    start = LevelPose(float(x), float(y), 0.0, POSE.yaw + np.radians(turn_deg))
    found, straight = (measured(shot, t11, place, FLOOR) for place in (start, POSE))
    assert straight.pose is not None
    apart = wrong(found, straight.pose)
    assert np.abs(apart[:3]).max() < 0.003
    assert abs(apart[3]) < np.radians(0.15)


def test_the_height_chooses_where_the_yaw_comes_from(rack_shot: Shot, rack_pallets: tuple[Placed, ...]) -> None:
    expected = [YawSource.BOTTOM, YawSource.FACE, YawSource.TOP]
    for (model, pose), source in zip(rack_pallets, expected, strict=True):
        assert horizontal_plane_for(rack_shot, Candidate(model, pose, None), CONFIG) is source
        candidate = measured(rack_shot, model, pose, HeightPrior(pose.z, 0.003))
        if source is YawSource.FACE:
            assert candidate.refusal in (None, (Stage.VERIFICATION, Reason.UNCERTAIN))
        else:
            assert candidate.refusal is None
        assert (candidate.yaw_from is YawSource.FACE) is (source is YawSource.FACE)
        assert (candidate.yaw is None) is (source is YawSource.FACE)
        if source is YawSource.TOP:
            assert candidate.yaw_from is not YawSource.BOTTOM


def test_near_the_cameras_height_the_covariance_tells_that_the_yaw_is_weak(
    rack_shot: Shot, rack_pallets: tuple[Placed, ...]
) -> None:
    sigmas = []
    for model, pose in rack_pallets[:2]:
        candidate = measured(rack_shot, model, pose, HeightPrior(pose.z, 0.003))
        assert candidate.covariance is not None
        sigmas.append(float(np.sqrt(candidate.covariance[3, 3])))
    assert sigmas[1] > 1.5 * sigmas[0]


@pytest.mark.parametrize(
    ("start", "reason"),
    [
        (replace(POSE, yaw=-np.pi / 2), Reason.BEHIND_FACE),
        (LevelPose(0.3, 0.0, 0.0, np.pi / 2), Reason.BEHIND_FACE),
        (replace(POSE, y=30.0), Reason.OUT_OF_RANGE),
    ],
)
def test_a_start_from_which_nothing_can_be_seen_is_refused(
    start: LevelPose, reason: Reason, portrait: Portrait, t11: PalletModel
) -> None:
    candidate = measured(portrait(t11, POSE), t11, start, None)
    assert candidate.refusal == (Stage.START, reason)
    assert candidate.pose is None


@pytest.mark.parametrize("aside_deg", [22.0, -22.0])
def test_a_face_cut_by_the_images_border_is_refused(
    aside_deg: float,
    portrait: Portrait,
    photograph: Callable[..., Shot],
    narrow_view: CameraModel,
    t11: PalletModel,
) -> None:
    straight = portrait(t11, POSE).mounting.forklift_from_camera
    yaw, pitch, roll = straight.rotation.as_euler("ZYX", degrees=True).tolist()
    shot = photograph(((t11, POSE),), narrow_view, (*straight.translation, yaw + aside_deg, pitch, roll))
    corners = POSE.transform().apply([[0.0, side * t11.width / 2, 0.0] for side in (-1, 1)])
    seen = narrow_view.project(shot.mounting.to_camera.apply(corners)).valid
    assert seen.sum() == 1
    candidate = measured(shot, t11, POSE, FLOOR)
    assert candidate.refusal is not None
    assert candidate.refusal[1] is Reason.OUT_OF_VIEW


def test_a_plain_image_gives_a_refusal(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    candidate = measured(replace(shot, image=np.full_like(shot.image, 90)), t11, POSE, FLOOR)
    assert candidate.refusal is not None
    assert candidate.pose is None


def test_the_nearest_of_the_long_lines_is_taken() -> None:
    long, near, short = BoundaryLine(0.01, 0.05, 200), BoundaryLine(0.02, -0.01, 150), BoundaryLine(0.03, 0.0, 60)
    assert nearest_line([long, near, short]) is near
    assert nearest_line([near, long]) is near
    assert nearest_line([replace(long, up=0.0), replace(near, up=0.05)]) == replace(long, up=0.0)
    assert nearest_line([long, short]) is long
    assert nearest_line([short]) is short
    assert nearest_line([]) is None
