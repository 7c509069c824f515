from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from palletloc.face import EdgeKind, FaceEdge, edge_shift, face_edges, face_lines, visible_lines
from palletloc.pallet import PalletModel
from palletloc.pallet_library import load_library

NEAR = 1e-4


def is_solid(model: PalletModel, right: float, up: float) -> bool:
    """Whether a point of the face plane lies in the solid, apart from rounded corners."""
    if abs(right) > model.width / 2 or not 0.0 <= up <= model.height:
        return False
    return not any(o.left < right < o.right and o.bottom < up < o.top for o in model.openings)


def sharp(model: PalletModel) -> PalletModel:
    openings = tuple(replace(opening, radius=0.0) for opening in model.openings)
    return replace(model, openings=openings, corner_radius=0.0, edge_radius=0.0)


def test_an_edge_parts_the_solid_from_what_is_outward_of_it(model: PalletModel) -> None:
    for edge in face_edges(model):
        start, end, outward = (np.array(v) for v in (edge.start, edge.end, edge.outward))
        assert np.linalg.norm(outward) == 1.0
        for share in (0.02, 0.5, 0.98):
            point = start + share * (end - start)
            assert is_solid(model, *(point - NEAR * outward))
            assert not is_solid(model, *(point + NEAR * outward))


def test_the_edges_of_a_sharp_face_are_its_whole_outline(model: PalletModel) -> None:
    face = sharp(model)
    holes = sum(2 * o.height + o.width * (1 if o.open_below else 2) for o in face.openings)
    floor = sum(o.width for o in face.openings if o.open_below)
    outline = 2 * face.width + 2 * face.height - floor
    assert sum(edge.length for edge in face_edges(face)) == pytest.approx(outline + holes)


def test_rounded_corners_are_left_out(model: PalletModel) -> None:
    radii = 4 * model.corner_radius * 2
    radii += sum(o.radius * (4 if o.open_below else 8) for o in model.openings)
    lost = sum(e.length for e in face_edges(sharp(model))) - sum(e.length for e in face_edges(model))
    assert lost == pytest.approx(radii, abs=1e-9)


def test_the_mirrored_face_has_the_mirrored_edges(model: PalletModel) -> None:
    openings = tuple(replace(o, center=-o.center) for o in reversed(model.openings))
    mirrored = {
        (edge.kind, *np.round([-edge.middle[0], edge.middle[1], edge.length], 9).tolist())
        for edge in face_edges(replace(model, openings=openings))
    }
    assert mirrored == {(edge.kind, *np.round([*edge.middle, edge.length], 9).tolist()) for edge in face_edges(model)}


def test_lines_are_all_the_edges_and_level_ones_at_one_height_are_one_line(model: PalletModel) -> None:
    lines = face_lines(model)
    assert Counter(edge for line in lines for edge in line.edges) == Counter(face_edges(model))
    places = Counter((line.kind, line.whole.middle[1]) for line in lines if line.whole.horizontal)
    assert set(places.values()) == {1}
    for line in lines:
        assert {edge.kind for edge in line.edges} == {line.kind}
        ends = [right for edge in line.edges for right in (edge.start[0], edge.end[0])]
        assert ends == sorted(ends)
        assert line.whole.start == line.edges[0].start
        assert line.whole.end == line.edges[-1].end
        if not line.whole.horizontal:
            assert len(line.edges) == 1


@pytest.mark.parametrize(
    "law",
    [
        test_an_edge_parts_the_solid_from_what_is_outward_of_it,
        test_the_edges_of_a_sharp_face_are_its_whole_outline,
        test_rounded_corners_are_left_out,
        test_the_mirrored_face_has_the_mirrored_edges,
        test_lines_are_all_the_edges_and_level_ones_at_one_height_are_one_line,
    ],
)
def test_it_holds_for_every_pallet_of_the_library(law: Callable[[PalletModel], None]) -> None:
    for each in load_library().values():
        law(each)


def test_a_face_open_below_stands_on_feet(open_below: PalletModel) -> None:
    kinds = Counter(edge.kind for edge in face_edges(open_below))
    assert kinds[EdgeKind.OPENING_BOTTOM] == 0
    feet = [(e.start[0], e.end[0]) for e in face_edges(open_below) if e.kind is EdgeKind.BOTTOM]
    np.testing.assert_allclose(feet, open_below.blocks)


def contour(radius: float, across: float, distance: float) -> float:
    """Where rays graze a rounded edge, on the face plane: by trying all points of the rounding.

    Across the edge the solid fills ``outward < 0``, ``towards the viewer < 0``; its corner is a quarter circle.
    """
    turn = np.linspace(0.0, np.pi / 2, 200_001)
    out, near = radius * (np.cos(turn) - 1), radius * (np.sin(turn) - 1)
    seen_at = across + (out - across) * distance / (distance - near)
    return float(seen_at.max())


def right_side(model: PalletModel) -> FaceEdge:
    return next(e for e in face_edges(model) if e.kind is EdgeKind.SIDE and e.outward[0] > 0)


@pytest.mark.parametrize("kind", [EdgeKind.TOP, EdgeKind.SIDE, EdgeKind.OPENING_TOP, EdgeKind.OPENING_SIDE])
@pytest.mark.parametrize("radius", [0.003, 0.010])
@pytest.mark.parametrize("tangent", [-0.1, -0.5, -1.0, -2.0])
def test_an_edge_that_hides_its_other_surface_appears_where_rays_graze_it(
    kind: EdgeKind, radius: float, tangent: float, t11: PalletModel
) -> None:
    model = replace(t11, edge_radius=radius)
    for edge in (e for e in face_edges(model) if e.kind is kind):
        across = 2.5 * tangent
        camera = np.array([*(np.array(edge.middle) + across * np.array(edge.outward)), 2.5])
        shift = edge_shift(edge, camera, model)
        assert shift.mean == pytest.approx(contour(radius, across, 2.5), abs=0.03 * radius)


@pytest.mark.parametrize("tangent", [-1.5, -0.4])
def test_a_lower_edge_appears_between_its_contour_and_its_drawn_place(tangent: float, t11: PalletModel) -> None:
    edge = next(e for e in face_edges(t11) if e.kind is EdgeKind.BOTTOM)
    camera = np.array([0.0, -2.0 * tangent, 2.0])
    shift = edge_shift(edge, camera, t11)
    assert contour(t11.edge_radius, 2.0 * tangent, 2.0) < shift.mean < 0.0


@pytest.mark.parametrize("tangent", [0.05, 0.4, 1.0, 2.0])
def test_an_edge_with_both_surfaces_in_view_appears_on_its_rounding(tangent: float, t11: PalletModel) -> None:
    edge, radius = right_side(t11), t11.edge_radius
    camera = np.array([edge.middle[0] + 2.0 * tangent, 1.0, 2.0])
    shift = edge_shift(edge, camera, t11)
    assert -radius <= shift.mean <= radius * tangent * 1.01


def test_sharp_edges_are_seen_where_they_are_drawn(t11: PalletModel) -> None:
    face = sharp(t11)
    for edge in face_edges(face):
        for camera in ([-2.0, -1.0, 2.0], [2.0, 1.5, 1.0]):
            shift = edge_shift(edge, np.array(camera), face)
            assert shift.mean == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("camera", [[0.3, 1.8, 2.0], [-2.0, -0.4, 1.5], [3.0, 0.1, 2.0]])
def test_the_rounder_an_edge_the_less_certain_is_its_place(camera: list[float], t11: PalletModel) -> None:
    wooden = replace(t11, edge_radius=0.003)
    for edge in face_edges(t11):
        sigmas = [edge_shift(edge, np.array(camera), model).sigma for model in (sharp(t11), wooden, t11)]
        assert 0.0 <= sigmas[0] < sigmas[1] < sigmas[2]


def test_the_mirrored_camera_sees_the_mirrored_shift(t11: PalletModel) -> None:
    camera = np.array([1.3, 1.7, 2.0])
    shifts = {
        (edge.kind, *np.round(edge.middle, 9).tolist()): edge_shift(edge, camera, t11) for edge in face_edges(t11)
    }
    for edge in face_edges(t11):
        mirrored = edge_shift(edge, camera * [-1, 1, 1], t11)
        here = shifts[(edge.kind, *np.round([-edge.middle[0], edge.middle[1]], 9).tolist())]
        assert mirrored.mean == pytest.approx(here.mean)
        assert mirrored.sigma == pytest.approx(here.sigma)


@pytest.mark.parametrize("up", [-1.0, 1.8])
def test_from_below_the_lower_edge_is_not_measured(up: float, open_below: PalletModel) -> None:
    kinds = {line.kind for line in visible_lines(open_below, np.array([0.0, up, 2.0]))}
    assert (EdgeKind.BOTTOM in kinds) is (up > 0)
    assert kinds | {EdgeKind.BOTTOM} == {line.kind for line in face_lines(open_below)}
