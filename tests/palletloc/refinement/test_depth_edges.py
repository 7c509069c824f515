from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from palletloc.cameras import CameraModel
from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.pallet import PalletModel
from palletloc.pallet_library import load_library
from palletloc.refinement.depth_edges import DepthEdge, DepthPeaks, find_depth_peaks, visible_depth_edges
from palletloc.synthetic.materials import WOODS
from palletloc.synthetic.pallet_solid import PalletBody

LIBRARY = load_library()
FACES = ["epal1-1200", "epal1-800"]
CAMERAS = [
    (aside, up, before) for aside in (-1.8, -0.7, 0.1, 1.2) for up in (-0.02, 0.07, 0.2) for before in (1.4, 2.3)
]
FORWARD = np.array([[0.0, 0.0, -1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""A camera's axes, seen from those of a plane before it."""
Striped = Callable[[PalletModel, float], tuple[tuple[DepthEdge, ...], DepthPeaks]]


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
def test_an_edge_its_image_and_the_camera_lie_on_one_line(name: str) -> None:
    for camera, edge in every_edge(name):
        image = np.array([*edge.image.middle, 0.0])
        way, whole = image - camera, np.array(edge.place) - camera
        np.testing.assert_allclose(way, whole * edge.scale, atol=1e-12)


@pytest.mark.parametrize("name", FACES)
def test_nothing_of_the_pallet_stands_before_an_edge_that_is_seen(name: str) -> None:
    model = LIBRARY[name]
    body = PalletBody(LevelPose(0.0, 0.0, 0.0, 0.0), model, WOODS[0])
    seen = every_edge(name)
    assert len(seen) > 60
    part = np.linspace(0.0, 1.0, 1500)
    for camera, edge in seen:
        right, up, near = (camera + part[:, None] * (np.array(edge.place) - camera)).T
        distance = body.distance(np.stack([-near, -right, up]).astype(np.float32))
        assert distance.min() > -0.001


@pytest.mark.parametrize("name", FACES)
def test_an_edge_is_one_of_a_block(name: str) -> None:
    model = LIBRARY[name]
    depths = [depth for row in model.block_rows for depth in row][1:]
    for _, edge in every_edge(name):
        right, _, near = edge.place
        assert near == -depths[edge.level]
        sides = [block[edge.outward > 0] for block in model.blocks]
        assert right in sides


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


@pytest.fixture
def striped(paint_plane: Callable[..., Image], narrow_view: CameraModel) -> Striped:
    """Return a function that looks for edges whose images are painted so far to the right of their places."""

    def shot(model: PalletModel, aside: float) -> tuple[tuple[DepthEdge, ...], DepthPeaks]:
        camera_from_face = FORWARD.copy()
        camera_from_face[:3, 3] = [1.6, 0.2, -0.07]  # aimed a bit to the left
        plane_from_camera = -camera_from_face[:3, :3].T @ camera_from_face[:3, 3]
        edges = visible_depth_edges(model, plane_from_camera)
        chosen = sorted(edges, key=lambda edge: edge.image.middle[0])
        places = [edge.image.middle[0] + aside for edge in chosen]

        def paint(points: FloatArray) -> FloatArray:
            return np.asarray(90.0 + 60.0 * (np.searchsorted(places, points[..., 0]) % 2), dtype=np.float64)

        image = paint_plane(narrow_view, camera_from_face, (-0.6, 0.6, -0.07, 0.2), paint)
        pixel = 1.6 / 560.0, 1.6 / 560.0
        reach = np.full(len(edges), 0.012)
        peaks = find_depth_peaks(narrow_view, image, camera_from_face, plane_from_camera, model, edges, reach, pixel)
        assert peaks is not None
        return edges, peaks

    return shot


@pytest.mark.parametrize("aside", [0.0, 0.005, -0.006])
def test_a_peak_is_found_where_the_image_changes(aside: float, striped: Striped) -> None:
    model = replace(LIBRARY["epal1-1200"], edge_radius=0.0)
    _, peaks = striped(model, aside)
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


def test_a_face_that_the_camera_does_not_see_shows_nothing_behind(narrow_view: CameraModel) -> None:
    model, plane_from_camera = LIBRARY["epal1-1200"], np.array([0.5, 0.07, 1.6])
    edges = visible_depth_edges(model, plane_from_camera)
    behind = FORWARD.copy()
    behind[:3, 3] = [-1.6, 0.0, 0.0]
    image = np.full((narrow_view.height, narrow_view.width), 90, np.uint8)
    reach = np.full(len(edges), 0.012)
    assert (
        find_depth_peaks(narrow_view, image, behind, plane_from_camera, model, edges, reach, (0.003, 0.003)) is None
    )
