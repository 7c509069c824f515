from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import palletloc.methods
from palletloc.cameras import CameraModel
from palletloc.candidate import Candidate, Fit, Refusal
from palletloc.config import LocalizerConfig
from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.measurement import HeightPrior, Reason, Stage, YawSource
from palletloc.methods import measure_refined
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.refinement.search import Search, search
from palletloc.shot import Shot
from palletloc.verification import of_use

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
FLOOR = HeightPrior(0.0, 0.003)
CONFIG = LocalizerConfig()
NAMES = pytest.mark.parametrize("name", ["epal", "t11", "open_below"])
HEIGHTS = pytest.mark.parametrize("height", [FLOOR, None], ids=["level", "free"])
Portrait = Callable[..., Shot]
Placed = tuple[PalletModel, LevelPose]


def measured(
    shot: Shot,
    model: PalletModel,
    start: LevelPose,
    height: HeightPrior | None = FLOOR,
    config: LocalizerConfig = CONFIG,
) -> Candidate:
    candidate = Candidate(model, start, height)
    measure_refined(shot, candidate, config)
    return candidate


def moved(pose: LevelPose, right: float = 0.0, depth: float = 0.0, turn_deg: float = 0.0) -> LevelPose:
    cos, sin = np.cos(pose.yaw), np.sin(pose.yaw)
    x, y = pose.x + cos * depth + sin * right, pose.y + sin * depth - cos * right
    return replace(pose, x=float(x), y=float(y), yaw=float(pose.yaw + np.radians(turn_deg)))


def wrong(candidate: Candidate, truth: LevelPose = POSE) -> FloatArray:
    assert candidate.pose is not None, candidate.refusal
    error = candidate.pose.as_array() - truth.as_array()
    error[3] = wrap_angle(error[3])
    return error


@NAMES
@HEIGHTS
@pytest.mark.parametrize(("right", "depth", "turn_deg"), [(0.02, 0.05, 3.0), (-0.04, -0.05, -4.0)])
def test_near_starts_lead_within_millimetres_as_the_covariance_says(
    name: str,
    height: HeightPrior | None,
    right: float,
    depth: float,
    turn_deg: float,
    portrait: Portrait,
    request: pytest.FixtureRequest,
) -> None:
    model: PalletModel = request.getfixturevalue(name)
    found = measured(portrait(model, POSE), model, moved(POSE, right, depth, turn_deg), height)
    assert found.refusal is None
    assert found.covariance is not None
    error = wrong(found)
    assert np.abs(error[:3]).max() < (0.010 if height else 0.025)
    assert abs(error[3]) < np.radians(0.6)
    assert error @ np.linalg.solve(found.covariance, error) < 20.0


@NAMES
@HEIGHTS
def test_a_covariance_is_symmetric_and_positive_definite(
    name: str, height: HeightPrior | None, portrait: Portrait, request: pytest.FixtureRequest
) -> None:
    model: PalletModel = request.getfixturevalue(name)
    covariance = measured(portrait(model, POSE), model, POSE, height).covariance
    assert covariance is not None
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9, atol=1e-15)
    assert np.linalg.eigvalsh(covariance).min() > 0


def test_without_a_level_the_viewing_ray_is_the_least_certain(portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    known, free = (measured(shot, epal, POSE, height).covariance for height in (FLOOR, None))
    assert known is not None
    assert free is not None
    assert (np.diag(free) > np.diag(known)).all()
    _, axes = np.linalg.eigh(free[:3, :3])
    ray = POSE.as_array()[:3] - shot.mounting.center
    assert abs(axes[:, -1] @ ray) > 0.9 * np.linalg.norm(ray)


@NAMES
@pytest.mark.parametrize("side", [-1.0, 1.0])
@HEIGHTS
def test_a_pallet_one_opening_aside_is_not_taken(
    name: str, side: float, height: HeightPrior | None, portrait: Portrait, request: pytest.FixtureRequest
) -> None:
    model: PalletModel = request.getfixturevalue(name)
    pitch = model.openings[1].center - model.openings[0].center
    found = measured(portrait(model, POSE), model, moved(POSE, side * pitch), height)
    if found.refusal is None:
        assert np.abs(wrong(found)[:3]).max() < 0.05
    else:
        assert found.refusal[0] is not Stage.START


def test_every_step_leaves_its_result(portrait: Portrait, t11: PalletModel) -> None:
    found = measured(portrait(t11, POSE), t11, moved(POSE, depth=0.04, turn_deg=2.0))
    assert found.refusal is None
    assert found.search is not None
    assert found.face is not None
    assert found.verification is not None
    assert found.verification.reason is None
    assert found.pose == found.face.forklift_from_pallet
    assert found.yaw_from is YawSource.BOTTOM
    assert (found.sweep, found.joint, found.yaw) == (None, None, None)


@pytest.mark.parametrize(("depth", "turn_deg"), [(0.08, 5.0), (-0.08, 5.0), (0.08, -5.0), (-0.08, -5.0)])
def test_all_starts_around_a_pallet_lead_to_the_same_pose(
    depth: float, turn_deg: float, portrait: Portrait, t11: PalletModel
) -> None:
    shot = portrait(t11, POSE)
    straight, aside = measured(shot, t11, POSE), measured(shot, t11, moved(POSE, depth=depth, turn_deg=turn_deg))
    assert straight.pose is not None
    apart = wrong(aside, straight.pose)
    assert np.abs(apart[:3]).max() < 0.002
    assert abs(apart[3]) < np.radians(0.1)


def test_far_starts_need_a_wide_search(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    start = moved(POSE, depth=0.35, turn_deg=15.0)
    narrow = measured(shot, t11, start)
    assert narrow.refusal is not None or np.abs(wrong(narrow)).max() < 0.02
    search = replace(CONFIG.search, turn_deg=24.0, nearer=0.9, farther=0.9)
    wide = measured(shot, t11, start, config=replace(CONFIG, search=search))
    assert wide.refusal is None
    assert np.abs(wrong(wide)[:3]).max() < 0.01
    assert abs(wrong(wide)[3]) < np.radians(0.6)


def test_at_every_height_a_pallet_is_measured_as_well_as_its_covariance_says_or_refused(
    rack_shot: Shot, rack_pallets: tuple[Placed, ...]
) -> None:
    sigmas = []
    for model, pose in rack_pallets:
        found = measured(rack_shot, model, moved(pose, 0.02, 0.03, 1.0), HeightPrior(pose.z, 0.003))
        assert found.covariance is not None
        error = wrong(found, pose)
        assert error @ np.linalg.solve(found.covariance, error) < 25.0
        assert found.refusal in (None, (Stage.VERIFICATION, Reason.UNCERTAIN))
        assert (found.refusal is None) == of_use(found.covariance, CONFIG.verification)
        sigmas.append(float(np.sqrt(found.covariance[3, 3])))
    assert sigmas[1] > 1.5 * sigmas[0]  # level with the camera only little tells the yaw


def test_an_uncertain_mounting_makes_the_pose_uncertain(portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    loose = Mounting(shot.mounting.forklift_from_camera, (0.004, 0.004, 0.004), (0.003, 0.003, 0.003))
    usual, unsure = (
        measured(replace(shot, mounting=mounting), epal, POSE).covariance for mounting in (shot.mounting, loose)
    )
    assert usual is not None
    assert unsure is not None
    assert np.linalg.eigvalsh(unsure - usual).min() > -1e-6
    assert np.sqrt(unsure[3, 3]) > 0.003
    assert np.sqrt(unsure[0, 0]) > 0.004


def test_no_colour_gives_nearly_the_same_pose(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    gray = replace(shot, image=np.asarray(shot.image.mean(axis=2), dtype=np.uint8))
    colour, without = measured(shot, t11, POSE), measured(gray, t11, POSE)
    assert colour.pose is not None
    assert without.covariance is not None
    assert (np.abs(wrong(without, colour.pose)) < 2 * np.sqrt(np.diag(without.covariance))).all()


@pytest.mark.parametrize(
    ("start", "stage", "reason"),
    [
        (replace(POSE, yaw=-np.pi / 2), Stage.START, Reason.BEHIND_FACE),
        (LevelPose(0.3, 0.0, 0.0, np.pi / 2), Stage.START, Reason.BEHIND_FACE),
        (replace(POSE, y=30.0), Stage.START, Reason.OUT_OF_RANGE),
        (replace(POSE, x=4.5), Stage.SEARCH, Reason.OUT_OF_VIEW),
    ],
)
def test_a_start_from_which_nothing_can_be_seen_is_refused(
    start: LevelPose, stage: Stage, reason: Reason, portrait: Portrait, t11: PalletModel
) -> None:
    found = measured(portrait(t11, POSE), t11, start)
    assert found.refusal == (stage, reason)
    assert found.pose is None


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
    found = measured(shot, t11, POSE)
    assert found.refusal is not None
    assert found.pose is None


@pytest.mark.parametrize("fill", ["plain", "noise"])
@HEIGHTS
def test_an_image_without_a_pallet_gives_a_refusal(
    fill: str, height: HeightPrior | None, portrait: Portrait, t11: PalletModel
) -> None:
    shot = portrait(t11, POSE)
    shape = shot.image.shape
    noise = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    image = noise if fill == "noise" else np.full(shape, 90, np.uint8)
    found = measured(replace(shot, image=image), t11, POSE, height)
    assert found.refusal is not None


def test_another_pallets_face_is_not_taken_for_it(
    portrait: Portrait, open_below: PalletModel, epal: PalletModel
) -> None:
    found = measured(portrait(open_below, POSE), epal, POSE)
    assert found.refusal is not None


def misled(monkeypatch: pytest.MonkeyPatch, right: float) -> None:
    """Let the search of hypotheses end a way aside of where it does."""

    def elsewhere(*where: Any) -> Search | Reason:
        looked = search(*where)
        if isinstance(looked, Reason):
            return looked
        peaks = tuple(replace(peak, pose=moved(peak.pose, right)) for peak in looked.found.peaks)
        return replace(looked, found=replace(looked.found, peaks=peaks), finer=())

    monkeypatch.setattr(palletloc.refined, "search", elsewhere)


@pytest.mark.parametrize(("height", "found"), [(FLOOR, True), (None, False)], ids=["level", "free"])
def test_on_a_level_a_start_is_tried_itself_where_the_search_leads_nowhere(
    monkeypatch: pytest.MonkeyPatch, portrait: Portrait, t11: PalletModel, height: HeightPrior | None, found: bool
) -> None:
    misled(monkeypatch, 0.2)
    candidate = measured(portrait(t11, POSE), t11, moved(POSE, 0.004, 0.006), height)
    assert (candidate.refusal is None) is found
    if found:
        assert np.abs(wrong(candidate)[:3]).max() < 0.01


def test_what_the_search_leads_to_counts_where_the_start_itself_leads_nowhere(
    monkeypatch: pytest.MonkeyPatch, portrait: Portrait, t11: PalletModel
) -> None:
    misled(monkeypatch, 0.2)
    both = measured(portrait(t11, POSE), t11, moved(POSE, 0.25))
    assert both.refusal is not None
    assert both.refusal[0] is Stage.VERIFICATION
