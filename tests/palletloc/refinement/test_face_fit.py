from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from palletloc.geometry import LevelPose
from palletloc.measurement import HeightPrior, Reason
from palletloc.pallet import PalletModel
from palletloc.refinement import face_fit
from palletloc.refinement.edges import SeenFace, measure_face
from palletloc.refinement.face_fit import SAME, SAME_DEG, FaceEstimate, FaceFitConfig, FacePrior, YawPrior, fit_face
from palletloc.shot import Shot

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
FLOOR = HeightPrior(0.0, 0.003)
TRUE_YAW = YawPrior(np.radians(0.1), 0.0)
Portrait = Callable[..., Shot]


def fitted(
    shot: Shot,
    model: PalletModel,
    start: LevelPose,
    height: HeightPrior = FLOOR,
    yaw: YawPrior | None = TRUE_YAW,
) -> FaceEstimate | Reason:
    return fit_face(shot, start, model, FacePrior(height, yaw, float(np.radians(5.0))), FaceFitConfig())


def estimate(
    shot: Shot,
    model: PalletModel,
    start: LevelPose = POSE,
    height: HeightPrior = FLOOR,
    yaw: YawPrior | None = TRUE_YAW,
) -> FaceEstimate:
    found = fitted(shot, model, start, height, yaw)
    assert isinstance(found, FaceEstimate)
    return found


def moved(pose: LevelPose, right: float, depth: float, up: float = 0.0) -> LevelPose:
    cos, sin = np.cos(pose.yaw), np.sin(pose.yaw)
    return replace(pose, x=pose.x + cos * depth + sin * right, y=pose.y + sin * depth - cos * right, z=pose.z + up)


def error(found: FaceEstimate, truth: LevelPose = POSE) -> np.ndarray:
    return found.forklift_from_pallet.minus(truth)


@pytest.mark.parametrize("yaw", [TRUE_YAW, None], ids=["yaw_known", "yaw_from_face"])
def test_the_pose_is_found_as_well_as_its_covariance_says(
    model: PalletModel, yaw: YawPrior | None, portrait: Portrait
) -> None:
    found = estimate(portrait(model, POSE), model, yaw=yaw)
    wrong = np.abs(error(found))
    assert (wrong < 3.5 * np.sqrt(np.diag(found.covariance))).all()
    assert wrong[:3].max() < 0.012
    assert wrong[3] < np.radians(1.0)
    assert 0.5 < found.coverage <= 1.0
    assert found.doubt < 2.5


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return a list that gets an entry for each time that a face is measured."""
    calls: list[Any] = []

    def counted(*given: Any) -> SeenFace | Reason:
        calls.append(given)
        return measure_face(*given)

    monkeypatch.setattr(face_fit, "measure_face", counted)
    return calls


PRIOR = FacePrior(FLOOR, TRUE_YAW, 0.1)


def test_from_the_result_of_another_fit_one_round_may_do(
    measured: list[Any], portrait: Portrait, t11: PalletModel
) -> None:
    shot = portrait(t11, POSE)
    there = estimate(shot, t11)
    for start, least, most in ((there.forklift_from_pallet, 1, 1), (moved(POSE, 0.008, -0.012), 2, 5)):
        measured.clear()
        found = fit_face(shot, start, t11, PRIOR, FaceFitConfig(), at_solution=True)
        assert isinstance(found, FaceEstimate)
        assert least <= len(measured) <= most
        apart = np.abs(error(found, there.forklift_from_pallet))
        assert apart[:3].max() < SAME
        assert apart[3] < np.radians(SAME_DEG)
        assert not found.repeated


def test_a_fit_ends_where_another_start_has_led(measured: list[Any], portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    restless = FaceFitConfig(small_motion=0.0)
    there = estimate(shot, t11).forklift_from_pallet
    rounds = []
    for known in ([], [moved(there, 0.5, 0.0)], [there]):
        measured.clear()
        found = fit_face(shot, moved(POSE, 0.004, -0.012), t11, PRIOR, restless, known)
        assert isinstance(found, FaceEstimate)
        assert np.abs(error(found, there)).max() < 0.01
        assert found.repeated is (there in known)
        rounds.append(len(measured))
    assert rounds[0] == rounds[1] == restless.iterations
    assert rounds[2] < restless.iterations


def test_a_fit_that_is_cut_short_says_how_far_off_it_may_be(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    start = replace(moved(POSE, 0.010, 0.015), yaw=POSE.yaw + np.radians(0.8))
    sigmas = []
    for rounds in (2, 6):
        config = FaceFitConfig(iterations=rounds, small_motion=1e-9)
        found = fit_face(shot, start, t11, FacePrior(FLOOR, None, float(np.radians(5.0))), config)
        assert isinstance(found, FaceEstimate)
        wrong = error(found)
        assert wrong @ np.linalg.solve(found.covariance, wrong) < 16.0
        sigmas.append(np.sqrt(np.linalg.eigvalsh(found.covariance)[-1]))
    assert sigmas[0] > 1.5 * sigmas[1]


@pytest.mark.parametrize(("right", "depth"), [(0.006, 0.0), (-0.006, 0.0), (0.0, 0.012), (0.004, -0.012)])
def test_starts_some_millimetres_apart_lead_to_the_same_pose(
    right: float, depth: float, portrait: Portrait, t11: PalletModel
) -> None:
    shot = portrait(t11, POSE)
    straight, aside = (estimate(shot, t11, start) for start in (POSE, moved(POSE, right, depth)))
    apart = error(aside, straight.forklift_from_pallet)
    assert np.abs(apart[:3]).max() < 0.002
    assert abs(apart[3]) < np.radians(0.1)


@pytest.mark.parametrize("yaw", [TRUE_YAW, None], ids=["yaw_known", "yaw_from_face"])
def test_a_covariance_is_symmetric_and_positive_definite(
    yaw: YawPrior | None, portrait: Portrait, epal: PalletModel
) -> None:
    covariance = estimate(portrait(epal, POSE), epal, yaw=yaw).covariance
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9, atol=1e-15)
    assert np.linalg.eigvalsh(covariance).min() > 0


def test_the_surer_the_known_yaw_the_surer_the_measured_one(portrait: Portrait, t11: PalletModel) -> None:
    shot, known = portrait(t11, POSE), np.radians([0.01, 0.1, 1.0])
    priors = [YawPrior(float(sigma), 0.0) for sigma in known]
    found = [estimate(shot, t11, yaw=prior) for prior in priors]
    sigmas = np.sqrt([face.covariance[3, 3] / max(face.chi2, 1.0) for face in found])
    assert (np.diff(sigmas) > 0).all()
    assert (sigmas < np.hypot(known, 2 * max(shot.mounting.rotation_sigma))).all()


def test_a_known_yaw_is_kept(portrait: Portrait, t11: PalletModel) -> None:
    start = replace(POSE, yaw=POSE.yaw + np.radians(0.8))
    firm = estimate(portrait(t11, POSE), t11, start, yaw=YawPrior(np.radians(0.01), 0.0))
    assert firm.forklift_from_pallet.yaw == pytest.approx(start.yaw, abs=np.radians(0.05))


def test_a_wrong_height_pulls_the_pallet_along_its_viewing_ray(portrait: Portrait, t11: PalletModel) -> None:
    shot, rise = portrait(t11, POSE), 0.005
    right, high = (estimate(shot, t11, POSE, HeightPrior(z, 1e-4)).forklift_from_pallet for z in (0.0, rise))
    assert high.z - right.z == pytest.approx(rise, abs=2e-4)
    below = shot.mounting.center[2] - t11.height / 2
    nearer = 1 - rise / below
    expected = nearer * (np.array([right.x, right.y]) - shot.mounting.center[:2]) + shot.mounting.center[:2]
    np.testing.assert_allclose([high.x, high.y], expected, atol=0.002)
    assert np.hypot(*(expected - [right.x, right.y])) > 0.005


def test_a_height_prior_makes_the_place_more_certain(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    sizes = [
        np.sqrt(np.trace(estimate(shot, t11, POSE, HeightPrior(0.0, sigma)).covariance[:3, :3]))
        for sigma in (0.001, 0.005, 0.3)
    ]
    assert sizes == sorted(sizes)
    assert sizes[2] > 1.5 * sizes[0]


def test_one_opening_aside_there_is_doubt(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    aside = fitted(shot, t11, moved(POSE, 0.53, 0.0))
    assert isinstance(aside, Reason) or aside.doubt > 1.2 * FaceFitConfig().max_doubt


def test_nothing_is_measured_in_a_plain_image(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    assert fitted(replace(shot, image=np.full_like(shot.image, 90)), t11, POSE) is Reason.FEW_EDGES


def test_a_face_that_is_not_wholly_seen_is_refused(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    assert fitted(shot, t11, moved(POSE, 1.0, 0.0)) is Reason.OUT_OF_VIEW
    assert fitted(shot, t11, replace(POSE, yaw=-np.pi / 2)) is Reason.BEHIND_FACE


def test_the_last_view_and_its_edges_are_kept(portrait: Portrait, t11: PalletModel) -> None:
    found = estimate(portrait(t11, POSE), t11, POSE)
    assert len(found.weights) == len(found.seen.edges) >= FaceFitConfig().min_edges
    assert ((found.weights >= 0) & (found.weights <= 1)).all()
