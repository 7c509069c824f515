from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from palletloc import Candidate, LevelPose, PalletModel, Shot
from palletloc.edge_fit import EdgeFit
from palletloc.face import EdgeKind, FaceEdge, FaceLine, edge_shift, face_lines
from palletloc.geometry import FloatArray
from palletloc.measurement import HeightPrior, Reason
from palletloc.methods import measure_refined
from palletloc.refinement import face_fit
from palletloc.refinement.edges import MeasuredEdge, SeenFace, measure_face
from palletloc.refinement.face_fit import SAME, SAME_DEG, FaceEstimate, FaceFitConfig, FacePrior, YawPrior, fit_face
from palletloc.refinement.level_lines import LevelYaw, yaw_from_level_lines
from tests.palletloc.poses import CONFIG, FLOOR, POSE, Portrait, blanked, moved

Yaw = YawPrior | None
TRUE_YAW = YawPrior(np.radians(0.1), 0.0)


def fitted(
    shot: Shot, model: PalletModel, start: LevelPose, height: HeightPrior = FLOOR, yaw: Yaw = TRUE_YAW
) -> FaceEstimate | Reason:
    return fit_face(shot, start, model, FacePrior(height, yaw, float(np.radians(5.0))), FaceFitConfig())


def estimate(
    shot: Shot, model: PalletModel, start: LevelPose = POSE, height: HeightPrior = FLOOR, yaw: Yaw = TRUE_YAW
) -> FaceEstimate:
    found = fitted(shot, model, start, height, yaw)
    assert isinstance(found, FaceEstimate)
    return found


def error(found: FaceEstimate, truth: LevelPose = POSE) -> np.ndarray:
    return found.forklift_from_pallet.minus(truth)


@pytest.mark.parametrize("yaw", [TRUE_YAW, None], ids=["yaw_known", "yaw_from_face"])
def test_the_pose_is_found_as_well_as_its_covariance_says(model: PalletModel, yaw: Yaw, portrait: Portrait) -> None:
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


def test_from_another_fits_result_one_round_may_do(measured: list[Any], portrait: Portrait, t11: PalletModel) -> None:
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
def test_near_starts_lead_to_one_pose(right: float, depth: float, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    straight, aside = (estimate(shot, t11, start) for start in (POSE, moved(POSE, right, depth)))
    apart = error(aside, straight.forklift_from_pallet)
    assert np.abs(apart[:3]).max() < 0.002
    assert abs(apart[3]) < np.radians(0.1)


@pytest.mark.parametrize("yaw", [TRUE_YAW, None], ids=["yaw_known", "yaw_from_face"])
def test_a_covariance_is_symmetric_and_positive_definite(yaw: Yaw, portrait: Portrait, epal: PalletModel) -> None:
    covariance = estimate(portrait(epal, POSE), epal, yaw=yaw).covariance
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9, atol=1e-15)
    assert np.linalg.eigvalsh(covariance).min() > 0


def test_the_surer_a_known_height_or_yaw_the_surer_the_measured_pose(portrait: Portrait, t11: PalletModel) -> None:
    shot, known = portrait(t11, POSE), np.radians([0.01, 0.1, 1.0])
    priors = [YawPrior(float(sigma), 0.0) for sigma in known]
    found = [estimate(shot, t11, yaw=prior) for prior in priors]
    sigmas = np.sqrt([face.covariance[3, 3] / max(face.chi2, 1.0) for face in found])
    assert (np.diff(sigmas) > 0).all()
    assert (sigmas < np.hypot(known, 2 * max(shot.mounting.rotation_sigma))).all()
    shot = portrait(t11, POSE)
    sizes = [
        np.sqrt(np.trace(estimate(shot, t11, POSE, HeightPrior(0.0, sigma)).covariance[:3, :3]))
        for sigma in (0.001, 0.005, 0.3)
    ]
    assert sizes == sorted(sizes)
    assert sizes[2] > 1.5 * sizes[0]


def test_a_known_yaw_is_kept_and_one_opening_aside_there_is_doubt(portrait: Portrait, t11: PalletModel) -> None:
    start = replace(POSE, yaw=POSE.yaw + np.radians(0.8))
    firm = estimate(portrait(t11, POSE), t11, start, yaw=YawPrior(np.radians(0.01), 0.0))
    assert firm.forklift_from_pallet.yaw == pytest.approx(start.yaw, abs=np.radians(0.05))
    aside = fitted(portrait(t11, POSE), t11, moved(POSE, 0.53, 0.0))
    assert isinstance(aside, Reason) or aside.doubt > 1.2 * FaceFitConfig().max_doubt


def test_a_wrong_height_pulls_the_pallet_along_its_viewing_ray(portrait: Portrait, t11: PalletModel) -> None:
    shot, rise = portrait(t11, POSE), 0.005
    right, high = (estimate(shot, t11, POSE, HeightPrior(z, 1e-4)).forklift_from_pallet for z in (0.0, rise))
    assert high.z - right.z == pytest.approx(rise, abs=2e-4)
    below = shot.mounting.center[2] - t11.height / 2
    nearer = 1 - rise / below
    expected = nearer * (np.array([right.x, right.y]) - shot.mounting.center[:2]) + shot.mounting.center[:2]
    np.testing.assert_allclose([high.x, high.y], expected, atol=0.002)
    assert np.hypot(*(expected - [right.x, right.y])) > 0.005


def test_a_plain_image_or_a_face_that_is_not_wholly_seen_is_refused(portrait: Portrait, t11: PalletModel) -> None:
    assert fitted(blanked(portrait(t11, POSE)), t11, POSE) is Reason.FEW_EDGES
    shot = portrait(t11, POSE)
    assert fitted(shot, t11, moved(POSE, 1.0, 0.0)) is Reason.OUT_OF_VIEW
    assert fitted(shot, t11, replace(POSE, yaw=-np.pi / 2)) is Reason.BEHIND_FACE


def test_the_last_view_and_its_edges_are_kept(portrait: Portrait, t11: PalletModel) -> None:
    found = estimate(portrait(t11, POSE), t11, POSE)
    assert len(found.weights) == len(found.seen.edges) >= FaceFitConfig().min_edges
    assert ((found.weights >= 0) & (found.weights <= 1)).all()


# The yaw that level lines tell.

ABOVE, BELOW = (-0.6, 1.8, 2.1), (0.4, -1.1, 2.1)
"""Where the camera is in the face's coordinates: right, up, towards the viewer."""
ERROR_PX = 0.15
LEVEL = (EdgeKind.BOTTOM, EdgeKind.TOP, EdgeKind.OPENING_TOP, EdgeKind.OPENING_BOTTOM)
Camera = tuple[float, float, float]


def seen_point(point: Sequence[float], camera: FloatArray, yaw: float) -> FloatArray:
    """Where a point of the face, turned about its middle, appears on the face's plane: by a ray."""
    right, up = point
    ray = np.array([right * np.cos(yaw), up, -right * np.sin(yaw)]) - camera
    reached: FloatArray = (camera - ray * camera[2] / ray[2])[:2]
    return reached


def line_of(line: FaceLine, model: PalletModel, camera: Camera, yaw: float, off: float, sigma: float) -> MeasuredEdge:
    """What is line_of of a line of a turned face, with a slope that is wrong by some."""
    edge: FaceEdge = line.whole
    center = np.array(camera)
    ends = [seen_point(point, center, yaw) - point for point in (edge.start, edge.end)]
    slope = float((ends[1] - ends[0]) @ edge.outward) / edge.length + off
    offset = float((seen_point(edge.middle, center, yaw) - edge.middle) @ edge.outward)
    fit = EdgeFit(offset, slope, 1e-4, sigma, 1.0, 10.0)
    return MeasuredEdge(edge, fit, 1e-3, edge_shift(edge, center, model), 0.003, 0.011, 1.0)


def turned(
    model: PalletModel,
    camera: Camera,
    yaw: float,
    kinds: Sequence[EdgeKind] = tuple(EdgeKind),
    off: dict[EdgeKind, float] | None = None,
    sigma: float = 1e-3,
) -> SeenFace:
    lines = [line for line in face_lines(model) if line.kind in kinds]
    wrong = off or {}
    edges = tuple(line_of(line, model, camera, yaw, wrong.get(line.kind, 0.0), sigma) for line in lines)
    return SeenFace(np.array(camera), np.eye(4), tuple(line.whole for line in lines), edges, len(edges))


def said(seen: SeenFace, error_px: float = ERROR_PX) -> LevelYaw:
    found = yaw_from_level_lines(seen, error_px)
    assert found is not None
    return found


@pytest.mark.parametrize("yaw", [-0.02, -0.004, 0.0, 0.004, 0.02])
@pytest.mark.parametrize("camera", [ABOVE, BELOW, (0.0, 0.6, 3.5)])
def test_the_level_lines_tell_how_far_a_face_is_turned(camera: Camera, yaw: float, epal: PalletModel) -> None:
    found = said(turned(epal, camera, yaw))
    assert found.turn == pytest.approx(yaw, abs=0.03 * abs(yaw) + 1e-6)
    assert abs(found.turn - yaw) < found.sigma


@pytest.mark.parametrize("kind", LEVEL)
def test_each_level_line_tells_it_alone(kind: EdgeKind, epal: PalletModel) -> None:
    found = said(turned(epal, BELOW, 0.01, [kind]))
    assert found.turn == pytest.approx(0.01, abs=5e-4)
    assert found.lines == 1


def test_more_lines_that_agree_are_surer_and_worse_slopes_less_certain(epal: PalletModel) -> None:
    few, many = (said(turned(epal, BELOW, 0.01, kinds)) for kinds in (LEVEL[:1], LEVEL))
    assert (few.lines, many.lines) == (1, 4)
    assert many.sigma < 0.7 * few.sigma
    slopes = [said(turned(epal, ABOVE, 0.01, sigma=sigma)).sigma for sigma in (1e-3, 3e-3, 1e-2)]
    pixels = [said(turned(epal, ABOVE, 0.01), error).sigma for error in (0.1, 1.0, 3.0)]
    assert (np.diff(slopes) > 0).all()
    assert (np.diff(pixels) > 0).all()


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["above", "below"])
def test_the_nearer_to_the_cameras_height_the_less_certain(side: float, epal: PalletModel) -> None:
    sigmas = [said(turned(epal, (0.2, 0.07 + side * up, 2.0), 0.01)).sigma for up in (1.6, 0.8, 0.4, 0.2)]
    assert (np.diff(sigmas) > 0).all()
    assert sigmas[-1] > 4 * sigmas[0]


def test_no_level_lines_or_such_at_the_cameras_height_tell_nothing(epal: PalletModel) -> None:
    up = epal.openings[0].top
    assert yaw_from_level_lines(turned(epal, (0.3, up, 2.0), 0.01, [EdgeKind.OPENING_TOP]), ERROR_PX) is None
    assert said(turned(epal, (0.3, up, 2.0), 0.01, LEVEL)).lines < len(LEVEL)
    assert yaw_from_level_lines(turned(epal, ABOVE, 0.01, [EdgeKind.SIDE, EdgeKind.OPENING_SIDE]), ERROR_PX) is None
    assert yaw_from_level_lines(turned(epal, ABOVE, 0.01, []), ERROR_PX) is None


@pytest.mark.parametrize("kind", LEVEL)
@pytest.mark.parametrize("off", [0.05, -0.05])
def test_one_line_of_four_that_contradicts_is_outvoted(kind: EdgeKind, off: float, epal: PalletModel) -> None:
    calm, disturbed = (said(turned(epal, BELOW, 0.01, LEVEL, off=wrong)) for wrong in ({}, {kind: off}))
    assert disturbed.turn == pytest.approx(calm.turn, abs=3e-4)
    assert disturbed.lines == calm.lines - 1 == 3
    assert disturbed.sigma >= calm.sigma


def test_lines_that_differ_are_less_certain_and_a_loaded_edge_has_no_say(epal: PalletModel) -> None:
    spread = {EdgeKind.BOTTOM: 2e-3, EdgeKind.TOP: 2e-3}
    calm, restless = (said(turned(epal, BELOW, 0.01, LEVEL, off=wrong)) for wrong in ({}, spread))
    assert restless.lines == calm.lines
    assert restless.sigma > 1.2 * calm.sigma
    calm, loaded = (said(turned(epal, ABOVE, 0.01, off=wrong)) for wrong in ({}, {EdgeKind.TOP: 0.003}))
    assert loaded == calm
    assert yaw_from_level_lines(turned(epal, ABOVE, 0.01, [EdgeKind.TOP]), ERROR_PX) is None
    assert yaw_from_level_lines(turned(epal, BELOW, 0.01, [EdgeKind.TOP]), ERROR_PX) is not None


@pytest.mark.parametrize("turn", [0.0, -0.1])
def test_on_the_floor_the_lines_agree_with_the_truth(model: PalletModel, turn: float, portrait: Portrait) -> None:
    pose = replace(POSE, yaw=POSE.yaw + turn)
    fit = measure_refined(portrait(model, pose), Candidate(model, pose, FLOOR), CONFIG).fit
    assert fit is not None
    assert fit.face is not None
    found = fit.face.level_yaw
    assert found is not None
    assert abs(fit.pose.yaw + found.turn - pose.yaw) < 3 * found.sigma
    assert found.sigma < np.radians(0.6)
