from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

from palletloc import CameraModel, LevelPose, Mounting, PalletModel, Shot, load_library
from palletloc.edge_fit import EdgeFit
from palletloc.face import edge_shift, face_lines
from palletloc.geometry import FloatArray
from palletloc.measurement import HeightPrior
from palletloc.refinement import depth_edges
from palletloc.refinement.depth_edges import DepthEdge, DepthPeaks, add_depth_edges, count_votes, visible_depth_edges
from palletloc.refinement.edges import MeasuredEdge, SeenFace
from palletloc.refinement.face_fit import FaceEstimate, FaceFitConfig, FacePrior, fit_face
from palletloc.refinement.normal_equations import FaceEquations
from palletloc.synthetic.materials import WOODS
from palletloc.synthetic.pallet_solid import PalletBody
from tests.palletloc.poses import Paints, Portrait

LIBRARY = load_library()
FACES = ["epal1-1200", "epal1-800"]
CAMERAS = [
    (aside, up, before) for aside in (-1.8, -0.7, 0.1, 1.2) for up in (-0.02, 0.07, 0.2) for before in (1.4, 2.3)
]


def every_edge(name: str) -> list[tuple[FloatArray, DepthEdge]]:
    return [
        (np.array(camera), edge)
        for camera in CAMERAS
        for edge in visible_depth_edges(LIBRARY[name], np.array(camera))
    ]


def test_nothing_is_seen_of_a_pallet_of_which_only_the_face_is_known() -> None:
    assert visible_depth_edges(LIBRARY["t11"], np.array([0.3, 0.07, 2.0])) == ()


@pytest.mark.parametrize("name", FACES)
def test_nothing_is_seen_through_openings_far_below(name: str) -> None:
    assert visible_depth_edges(LIBRARY[name], np.array([0.3, 1.8, 1.2])) == ()


@pytest.mark.parametrize("name", FACES)
def test_an_edge_of_a_block_its_image_and_the_camera_lie_on_one_line(name: str) -> None:
    for camera, edge in every_edge(name):
        way, whole = np.array([*edge.image.middle, 0.0]) - camera, np.array(edge.place) - camera
        np.testing.assert_allclose(way, whole * edge.scale, atol=1e-12)
    model = LIBRARY[name]
    depths = [depth for row in model.block_rows for depth in row][1:]
    for _, edge in every_edge(name):
        right, _, near = edge.place
        assert near == -depths[edge.level]
        sides = [block[edge.outward > 0] for block in model.blocks]
        assert right in sides


@pytest.mark.parametrize("name", FACES)
def test_nothing_of_the_pallet_stands_before_an_edge_that_is_seen(name: str) -> None:
    body = PalletBody(LevelPose(0.0, 0.0, 0.0, 0.0), LIBRARY[name], WOODS[0])
    seen = every_edge(name)
    assert len(seen) > 60
    part = np.linspace(0.0, 1.0, 1500)
    for camera, edge in seen:
        right, up, near = (camera + part[:, None] * (np.array(edge.place) - camera)).T
        distance = body.distance(np.stack([-near, -right, up]).astype(np.float32))
        assert distance.min() > -0.001


@pytest.mark.parametrize("name", FACES)
def test_a_camera_on_the_other_side_sees_the_same_mirrored(name: str) -> None:
    model = LIBRARY[name]
    for aside, up, before in CAMERAS:
        here = visible_depth_edges(model, np.array([aside, up, before]))
        there = visible_depth_edges(model, np.array([-aside, up, before]))
        mirrored = {(-edge.image.middle[0], -edge.outward, edge.level, edge.contour) for edge in there}
        places = {(edge.image.middle[0], edge.outward, edge.level, edge.contour) for edge in here}
        assert {tuple(np.round(place, 9)) for place in places} == {tuple(np.round(place, 9)) for place in mirrored}


def test_the_backs_of_blocks_are_contours() -> None:
    for _, edge in every_edge("epal1-1200"):
        assert edge.contour or edge.level % 2 == 1


# Peaks around the places of edges.

STRAIGHT = Mounting(RigidTransform.identity())
BEFORE = LevelPose(1.6, 0.2, -0.07, 0.0)
"""Before a camera at the origin that looks straight ahead, aimed at a bit to the left."""
PIXEL = 1.6 / 560.0
Striped = Callable[[PalletModel, float], tuple[tuple[DepthEdge, ...], DepthPeaks]]


def seen_face(shot: Shot, model: PalletModel) -> SeenFace:
    """A face whose edges all lie where they should, each known to a hundredth of a millimetre."""
    camera, fit = shot.camera_in(BEFORE), EdgeFit(0.0, 0.0, 1e-5, 1e-5, 1.0, 10.0)
    lines = tuple(line.whole for line in face_lines(model))
    edges = tuple(MeasuredEdge(line, fit, 1e-5, edge_shift(line, camera, model), PIXEL, 0.011, 1.0) for line in lines)
    return SeenFace(camera, shot.camera_from_face(BEFORE), lines, edges, len(lines))


def added(shot: Shot, model: PalletModel, seen: SeenFace, doubt: float = 0.0) -> float:
    system = FaceEquations(seen, BEFORE, shot.mounting, model)
    system.add_turn(0.0, 1e-4)
    return add_depth_edges(shot, model, system, system.solve(), doubt)


@pytest.fixture
def noted(monkeypatch: pytest.MonkeyPatch) -> list[DepthPeaks]:
    """Return a list that gets the peaks whenever they vote."""
    found: list[DepthPeaks] = []

    def note(peaks: DepthPeaks, *rest: Any) -> depth_edges.Vote:
        found.append(peaks)
        return count_votes(peaks, *rest)

    monkeypatch.setattr(depth_edges, "count_votes", note)
    return found


@pytest.fixture
def striped(paint_plane: Paints, narrow_view: CameraModel, noted: list[DepthPeaks]) -> Striped:
    """Return a function that looks for edges whose images are painted so far to the right of their places."""

    def looked(model: PalletModel, aside: float) -> tuple[tuple[DepthEdge, ...], DepthPeaks]:
        blank = Shot(np.zeros((narrow_view.height, narrow_view.width), np.uint8), narrow_view, STRAIGHT)
        edges = visible_depth_edges(model, blank.camera_in(BEFORE))
        places = sorted(edge.image.middle[0] + aside for edge in edges)

        def paint(points: FloatArray) -> FloatArray:
            return np.asarray(90.0 + 60.0 * (np.searchsorted(places, points[..., 0]) % 2), dtype=np.float64)

        image = paint_plane(narrow_view, blank.camera_from_face(BEFORE), (-0.6, 0.6, -0.07, 0.2), paint)
        added(replace(blank, image=image), model, seen_face(blank, model))
        (peaks,) = noted
        return edges, peaks

    return looked


@pytest.mark.parametrize("aside", [0.0, 0.005, -0.006])
def test_a_peak_is_found_where_the_image_changes(aside: float, striped: Striped) -> None:
    _, peaks = striped(replace(LIBRARY["epal1-1200"], edge_radius=0.0), aside)
    strongest = [places[shares.argmax()] for places, shares in zip(peaks.places, peaks.shares, strict=True)]
    assert len(strongest) >= 4
    assert np.median(np.abs(np.array(strongest) - aside)) < 0.002


def test_shares_of_an_edges_peaks_add_up(striped: Striped) -> None:
    _, peaks = striped(LIBRARY["epal1-1200"], 0.003)
    for shares in peaks.shares:
        assert not len(shares) or shares.sum() == pytest.approx(1.0)
        assert (shares >= 0).all()


def test_edges_too_close_to_another_are_left_out(striped: Striped) -> None:
    edges, peaks = striped(LIBRARY["epal1-1200"], 0.0)
    middles = [edge.image.middle[0] for edge in edges]
    for edge in peaks.edges:
        assert min(abs(edge.image.middle[0] - other) for other in middles if other != edge.image.middle[0]) > 0.005
    assert 0 < len(peaks.edges) < len(edges)


def test_nothing_is_added_where_the_camera_does_not_see_the_face_or_its_pose_is_too_doubtful(
    narrow_view: CameraModel, noted: list[DepthPeaks]
) -> None:
    model = LIBRARY["epal1-1200"]
    shot = Shot(np.full((narrow_view.height, narrow_view.width), 90, np.uint8), narrow_view, STRAIGHT)
    seen = seen_face(shot, model)
    behind = seen.camera_from_face.copy()
    behind[:3, 3] = [-1.6, 0.0, 0.0]
    assert added(shot, model, replace(seen, camera_from_face=behind)) == 0.0
    assert added(shot, model, seen, depth_edges.MOST_DOUBT + 0.1) == 0.0
    assert added(shot, LIBRARY["t11"], seen_face(shot, LIBRARY["t11"])) == 0.0
    assert noted == []


# Their votes.

EPAL = LIBRARY["epal1-1200"]
EDGES = visible_depth_edges(EPAL, np.array([-0.9, 0.07, 1.8]))
CONTOURS = tuple(edge for edge in EDGES if edge.contour)
RIDGE = np.array([0.002, 0.003, 0.006, -0.004, 0.005])
SIGMA = np.full(5, 0.002)
START = np.array([0.001, -0.002, 0.0, 0.003, 0.0])
LEVEL = LevelPose(1.1, 1.9, 1.78, np.pi / 2 + 0.02)


def peaks_at(*places: FloatArray) -> DepthPeaks:
    """Peaks of equal strength around five contours: each array has one for every edge."""
    own = tuple(np.array(each) for each in zip(*places, strict=True)) if places else (np.zeros(0),) * 5
    shares = tuple(np.full(len(each), 1 / max(len(each), 1)) for each in own)
    return DepthPeaks((CONTOURS * 5)[:5], own, shares, np.full(5, 0.03))


@given(st.floats(-2.5, 2.5))
def test_peaks_that_agree_tell_the_place_on_the_ridge(place: float) -> None:
    vote = count_votes(peaks_at(START + place * RIDGE), START, RIDGE, SIGMA, 1.0)
    assert vote.place == pytest.approx(place, abs=0.05)
    assert vote.sigma == pytest.approx(float(np.sqrt(1 / (RIDGE**2 / SIGMA**2).sum())), rel=0.1)
    assert vote.evidence > 2


@given(st.floats(-2.0, 2.0), st.integers(0, 4), st.floats(-0.02, 0.02))
def test_one_peak_that_contradicts_hardly_matters(place: float, which: int, off: float) -> None:
    places = START + place * RIDGE
    places[which] += off
    vote = count_votes(peaks_at(places), START, RIDGE, SIGMA, 1.0)
    assert abs(vote.place - place) < 4 * vote.sigma
    assert vote.evidence > 0


def test_other_peaks_are_left_out_and_those_nowhere_near_speak_against_the_pose() -> None:
    others = np.random.default_rng(3).uniform(-0.025, 0.025, (3, 5))
    vote = count_votes(peaks_at(START + RIDGE, *others), START, RIDGE, SIGMA, 1.0)
    assert abs(vote.place - 1.0) < 3 * vote.sigma
    assert vote.sigma < 0.6
    vote = count_votes(peaks_at(np.full(5, 0.029)), START, RIDGE, SIGMA / 4, 1.0)
    assert vote.evidence < -2
    assert vote.sigma > 3


def test_without_any_peak_or_with_two_equally_good_ones_the_place_is_open() -> None:
    vote = count_votes(peaks_at(), START, RIDGE, SIGMA, 1.0)
    assert vote.evidence == pytest.approx(0.0)
    assert vote.sigma > 30
    both = count_votes(peaks_at(START - 2 * RIDGE, START + 2 * RIDGE), START, RIDGE, SIGMA, 1.0)
    assert abs(both.place) < both.sigma
    assert both.sigma > 2


def test_a_wide_ridge_is_searched_farther_and_a_crease_counts_less_than_a_contour() -> None:
    found = peaks_at(START + 7 * RIDGE)
    narrow, wide = (count_votes(found, START, RIDGE, SIGMA, width) for width in (1.0, 4.0))
    assert wide.place == pytest.approx(7.0, abs=0.2)
    assert wide.evidence > narrow.evidence
    contours = peaks_at(START + RIDGE)
    creases = replace(contours, edges=tuple(replace(edge, contour=False) for edge in contours.edges))
    strong, weak = (count_votes(peaks, START, RIDGE, SIGMA, 1.0) for peaks in (contours, creases))
    assert 0 < depth_edges.CREASE_SEEN < 1
    assert strong.evidence > weak.evidence > 0


# In pictures of pallets at the camera's height.


def fitted(shot: Shot, model: PalletModel, pose: LevelPose = LEVEL) -> FaceEstimate:
    start = replace(pose, x=pose.x + 0.004, yaw=pose.yaw + np.radians(0.5))
    prior = FacePrior(HeightPrior(pose.z, 0.003), None, float(np.radians(5.0)))
    found = fit_face(shot, start, model, prior, FaceFitConfig())
    assert isinstance(found, FaceEstimate)
    return found


def yaw_error(found: FaceEstimate, pose: LevelPose = LEVEL) -> float:
    return float(found.forklift_from_pallet.yaw - pose.yaw)


def yaw_sigma(found: FaceEstimate) -> float:
    return float(np.sqrt(found.covariance[3, 3]))


@pytest.mark.parametrize("name", ["epal1-1200", "epal1-800"])
def test_edges_behind_the_face_make_the_yaw_more_certain(name: str, portrait: Portrait) -> None:
    model, gains = LIBRARY[name], []
    for aside in (0.5, 1.1, 1.7):
        pose = replace(LEVEL, x=aside)
        shot = portrait(model, pose)
        alone, together = fitted(shot, replace(model, block_rows=()), pose), fitted(shot, model, pose)
        assert alone.behind == 0.0
        assert abs(yaw_error(together, pose)) < 3 * yaw_sigma(together)
        gains.append(yaw_sigma(together) / yaw_sigma(alone))
    assert max(gains) < 1.05
    assert np.mean(gains) < 0.8


def test_wrong_blocks_do_no_harm_and_far_above_blocks_change_nothing(portrait: Portrait) -> None:
    shot = portrait(EPAL, LEVEL)
    wrong = replace(EPAL, block_rows=((0.0, 0.06), (0.19, 0.27), (0.55, 0.61)))
    alone, misled = (fitted(shot, model) for model in (replace(EPAL, block_rows=()), wrong))
    assert misled.doubt <= alone.doubt + 0.3
    assert abs(yaw_error(misled)) < 3.5 * yaw_sigma(misled)
    pose = replace(LEVEL, z=0.0)
    shot = portrait(EPAL, pose)
    first, second = (
        fitted(shot, model, pose).forklift_from_pallet.as_array() for model in (EPAL, replace(EPAL, block_rows=()))
    )
    np.testing.assert_allclose(first, second, atol=1e-12)
