"""Pallets with a post or a carton before part of the face: measured as well as the covariance says, or refused."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from palletloc import Candidate, Fit, LevelPose, PalletModel, Refusal, Shot
from palletloc.face import face_lines
from palletloc.geometry import FloatArray
from palletloc.measurement import Reason
from palletloc.methods import measure_refined
from palletloc.refinement import face_fit
from palletloc.refinement.face_fit import FaceEstimate, FaceFitConfig, FacePrior, YawPrior, fit_face
from tests.palletloc.poses import CONFIG, FLOOR, POSE, Portrait, found, moved

LENS_BLUR = 0.7
"""Standard deviation of the blur of what is painted, in pixels."""
NOISE = 1.5
"""Standard deviation of its noise, in gray levels."""
BEFORE = 0.05
"""How far before the face the board stands, in metres."""
TALL = 1.5
"""Height of the board, in metres."""
COLOURS = {"orange": (60, 140, 190), "dark": (40, 40, 40)}


def behind(shot: Shot, left: float, right: float, colour: str = "orange") -> Shot:
    """Stand a flat board upright before a stretch of the face; places on it in metres from its middle."""
    rows, columns = np.mgrid[: shot.image.shape[0], : shot.image.shape[1]]
    rays, origins, _ = shot.camera.unproject(np.stack([columns, rows], -1).astype(float))
    pallet_from_camera = (shot.mounting.to_camera * POSE.transform()).inv().as_matrix()
    rays = rays @ pallet_from_camera[:3, :3].T
    origins = origins @ pallet_from_camera[:3, :3].T + pallet_from_camera[:3, 3]
    points = origins + rays * ((-BEFORE - origins[..., 0]) / rays[..., 0])[..., None]
    along, up = -points[..., 1], points[..., 2]
    part: FloatArray = np.ones(along.shape)
    for place, low, high, axis in ((along, left, right, 1), (up, 0.0, TALL, 0)):
        pixel = np.abs(np.gradient(place, axis=axis))
        part *= np.clip((place - low) / pixel + 0.5, 0, 1) * np.clip((high - place) / pixel + 0.5, 0, 1)
    part = np.asarray(cv2.GaussianBlur(part, (0, 0), LENS_BLUR), dtype=float)[..., None]
    board = np.array(COLOURS[colour]) + np.random.default_rng(5).normal(0.0, NOISE, shot.image.shape)
    image = np.clip(np.rint(shot.image * (1 - part) + board * part), 0, 255).astype(np.uint8)
    return replace(shot, image=image)


def covered(model: PalletModel, side: str, part: float) -> tuple[float, float]:
    """Return the ends of a board that hides at least a part of the face, from a side or in the middle."""
    half = model.width / 2
    ends = {
        "left": (-half - 0.1, -half + part * model.width),
        "right": (half - part * model.width, half + 0.1),
        "middle": (-part * half, part * half),
    }
    return ends[side]


def measured(shot: Shot, model: PalletModel, start: LevelPose) -> Fit | Refusal:
    return measure_refined(shot, Candidate(model, start, FLOOR), CONFIG)


def fitted(shot: Shot, model: PalletModel, config: FaceFitConfig = CONFIG.face_fit) -> FaceEstimate | Reason:
    return fit_face(shot, POSE, model, FacePrior(FLOOR, YawPrior(float(np.radians(0.1)), 0.0), 0.1), config)


def estimate(shot: Shot, model: PalletModel) -> FaceEstimate:
    found = fitted(shot, model)
    assert isinstance(found, FaceEstimate)
    return found


def assert_right_or_refused(found: Fit | Refusal, metres: float = np.inf) -> None:
    """No row, or edge whose pose is as right as it says."""
    if isinstance(found, Fit):
        wrong = np.abs(found.pose.minus(POSE))
        assert (wrong < 4 * np.sqrt(np.diag(found.covariance))).all()
        assert wrong[:3].max() < metres


def test_nothing_hides_a_free_face(model: PalletModel, portrait: Portrait) -> None:
    found = estimate(portrait(model, POSE), model)
    assert found.hidden == ()
    assert found.seen.hidden == ()
    assert found.seen.hidden_part == 0.0


@pytest.mark.parametrize("width", [0.08, 0.15])
@pytest.mark.parametrize("place", [-0.5, -0.3, 0.0, 0.3, 0.5])
def test_a_pallet_behind_a_post_is_right_or_refused(
    place: float, width: float, model: PalletModel, portrait: Portrait
) -> None:
    middle = place * model.width
    shot = behind(portrait(model, POSE), middle - width / 2, middle + width / 2)
    assert_right_or_refused(measured(shot, model, moved(POSE, 0.01)), 0.012)


@pytest.mark.parametrize("width", [0.08, 0.12, 0.15])
@pytest.mark.parametrize(
    ("model", "middle"), [("t11", -0.33), ("t11", 0.33), ("epal", -0.55), ("epal", 0.55)], indirect=["model"]
)
def test_a_post_before_a_part_costs_no_row(
    model: PalletModel, middle: float, width: float, portrait: Portrait
) -> None:
    shot = behind(portrait(model, POSE), middle - width / 2, middle + width / 2)
    wrong = np.abs(found(measured(shot, model, moved(POSE, 0.01))).pose.minus(POSE))
    assert wrong[:3].max() < 0.008
    assert wrong[3] < np.radians(0.4)


@pytest.mark.parametrize("side", ["left", "right", "middle"])
@pytest.mark.parametrize("part", [0.2, 0.33])
def test_with_up_to_a_third_covered_a_pose_is_right_or_refused(
    part: float, side: str, model: PalletModel, portrait: Portrait
) -> None:
    shot = behind(portrait(model, POSE), *covered(model, side, part))
    assert_right_or_refused(measured(shot, model, moved(POSE, 0.01)), 0.012)


@pytest.mark.parametrize("side", ["left", "right", "middle"])
@pytest.mark.parametrize(("part", "colour"), [(0.55, "dark"), (0.7, "orange")])
def test_with_more_than_half_covered_no_row_is_wrong(
    part: float, side: str, colour: str, model: PalletModel, portrait: Portrait
) -> None:
    shot = behind(portrait(model, POSE), *covered(model, side, part), colour)
    assert_right_or_refused(measured(shot, model, moved(POSE, 0.01)))


@pytest.mark.parametrize(("part", "side"), [(0.0, "left"), (0.2, "left"), (0.45, "right")])
@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_one_opening_aside_no_pallet_is_seen_half_hidden(
    way: float, part: float, side: str, model: PalletModel, portrait: Portrait
) -> None:
    pitch = model.openings[1].center - model.openings[0].center
    shot = portrait(model, POSE)
    if part:
        shot = behind(shot, *covered(model, side, part))
    assert_right_or_refused(measured(shot, model, moved(POSE, way * pitch)), 0.05)


@pytest.mark.parametrize("ends", [(-0.27, 0.22), (0.2, 0.6)], ids=["middle", "right"])
def test_what_a_board_hides_is_listed(ends: tuple[float, float], t11: PalletModel, portrait: Portrait) -> None:
    found = estimate(behind(portrait(t11, POSE), *ends), t11)
    left, right = ends
    assert len(found.seen.hidden) == 1
    np.testing.assert_allclose(found.seen.hidden[0], (left, min(right, t11.width / 2)), atol=0.09)
    assert found.seen.hidden_part == pytest.approx(np.diff(found.seen.hidden)[0, 0] / t11.width)
    uprights = {line.whole for line in face_lines(t11) if not line.whole.horizontal}
    within = {edge for edge in uprights if left + 0.09 < edge.middle[0] < right - 0.09}
    assert within
    assert within <= set(found.hidden)
    # the board stands a little before the face
    assert all(edge.horizontal or left - 0.09 < edge.middle[0] < right + 0.09 for edge in found.hidden)
    measured_edges = {edge.edge for edge in found.seen.edges}
    assert not measured_edges & set(found.hidden)
    assert len(measured_edges) >= FaceFitConfig().min_edges


@pytest.mark.parametrize("side", ["left", "right"])
def test_what_is_hidden_at_a_side_makes_no_pose_surer(side: str, model: PalletModel, portrait: Portrait) -> None:
    shot = portrait(model, POSE)
    free, hidden = estimate(shot, model), fitted(behind(shot, *covered(model, side, 0.3)), model)
    if isinstance(hidden, FaceEstimate):
        # beside the scatter of the edges that are left, which may be smaller
        sigmas = [np.sqrt(np.diag(fit.covariance) / max(fit.chi2, 1.0)) for fit in (free, hidden)]
        assert (sigmas[1] > 0.9 * sigmas[0]).all()


def test_a_hidden_edge_counts_half_and_too_much_hidden_is_refused(t11: PalletModel, portrait: Portrait) -> None:
    found = estimate(behind(portrait(t11, POSE), 0.2, 0.6), t11)
    assert len(found.hidden) > 0
    seen = found.seen
    missing = seen.expected - sum(
        edge.evidence_weight * weight for edge, weight in zip(seen.edges, found.weights, strict=True)
    )
    free = missing + max(found.chi2 - 1.0, 0.0) - face_fit.EDGES_PER_NAT * found.behind
    assert found.doubt - free == pytest.approx(face_fit.HIDDEN_DOUBT * len(found.hidden))
    shot = behind(portrait(t11, POSE), 0.1, 0.42)
    part = estimate(shot, t11).seen.hidden_part
    assert 0.1 < part < FaceFitConfig().max_hidden
    assert fitted(shot, t11, FaceFitConfig(max_hidden=0.5 * part)) is Reason.HIDDEN
    assert isinstance(fitted(shot, t11, FaceFitConfig(max_hidden=1.1 * part)), FaceEstimate)
