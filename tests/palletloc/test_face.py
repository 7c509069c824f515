from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc import Fit, LevelPose, Opening, PalletModel, ShelfPlane, Shot, Start
from palletloc.edge_fit import EdgeFit
from palletloc.explained import EdgeFate, SearchAxes, account_edges, edge_name, name_candidates
from palletloc.face import EdgeKind, EdgeShift, FaceEdge, edge_shift, face_edges, face_lines, visible_lines
from palletloc.pallet_library import load_library
from palletloc.refinement.edges import MeasuredEdge, SeenFace
from tests.palletloc.poses import Makes, Pallets

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


def test_edges_are_the_whole_outline_but_for_rounded_corners(model: PalletModel) -> None:
    face = sharp(model)
    holes = sum(2 * o.height + o.width * (1 if o.open_below else 2) for o in face.openings)
    outline = 2 * face.width + 2 * face.height - sum(o.width for o in face.openings if o.open_below)
    assert sum(edge.length for edge in face_edges(face)) == pytest.approx(outline + holes)
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
        test_edges_are_the_whole_outline_but_for_rounded_corners,
        test_the_mirrored_face_has_the_mirrored_edges,
        test_lines_are_all_the_edges_and_level_ones_at_one_height_are_one_line,
    ],
)
def test_it_holds_for_every_pallet_of_the_library(law: Callable[[PalletModel], None]) -> None:
    for each in load_library().values():
        law(each)


def test_a_face_open_below_stands_on_feet(open_below: PalletModel) -> None:
    assert Counter(edge.kind for edge in face_edges(open_below))[EdgeKind.OPENING_BOTTOM] == 0
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
    shift = edge_shift(edge, np.array([0.0, -2.0 * tangent, 2.0]), t11)
    assert contour(t11.edge_radius, 2.0 * tangent, 2.0) < shift.mean < 0.0


@pytest.mark.parametrize("tangent", [0.05, 0.4, 1.0, 2.0])
def test_an_edge_with_both_surfaces_in_view_appears_on_its_rounding(tangent: float, t11: PalletModel) -> None:
    edge = next(e for e in face_edges(t11) if e.kind is EdgeKind.SIDE and e.outward[0] > 0)
    shift = edge_shift(edge, np.array([edge.middle[0] + 2.0 * tangent, 1.0, 2.0]), t11)
    assert -t11.edge_radius <= shift.mean <= t11.edge_radius * tangent * 1.01


def test_sharp_edges_are_seen_where_they_are_drawn(t11: PalletModel) -> None:
    face = sharp(t11)
    for edge in face_edges(face):
        for camera in ([-2.0, -1.0, 2.0], [2.0, 1.5, 1.0]):
            assert edge_shift(edge, np.array(camera), face).mean == pytest.approx(0.0, abs=1e-12)


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


# What became of the edges and candidates.

FROM_ABOVE, FROM_BELOW = np.array([0.2, 1.2, 2.0]), np.array([0.2, -0.6, 2.0])


def measured(edge: FaceEdge) -> MeasuredEdge:
    fit, shift = EdgeFit(0.002, 0.0, 1e-3, 1e-3, 0.9, 20.0), EdgeShift(0.0, 0.004, True)
    return MeasuredEdge(edge, fit, 0.003, shift, 0.004, 0.011, 1.0)


def face(edges: list[FaceEdge], weights: list[float], camera: Any = FROM_ABOVE, **fields: Any) -> Any:
    """Return what stands for a fit: its edges and their weights."""
    seen = SeenFace(camera, np.eye(4), (), tuple(measured(edge) for edge in edges), expected=len(edges))
    return SimpleNamespace(seen=seen, weights=np.array(weights), **({"hidden": ()} | fields))


def lines(model: PalletModel) -> list[FaceEdge]:
    return [line.whole for line in face_lines(model)]


def test_every_line_has_one_entry_with_its_fate_even_if_hidden(t11: PalletModel) -> None:
    used, rejected, *others = lines(t11)
    accounts = account_edges(face([used, rejected], [0.9, 0.1]), t11)
    assert [account.edge for account in accounts] == [used, rejected, *others]
    assert [account.number for account in accounts] == list(range(1, len(accounts) + 1))
    assert [account.fate for account in accounts[:2]] == [EdgeFate.USED, EdgeFate.REJECTED]
    assert {account.fate for account in accounts[2:]} == {EdgeFate.NOT_SEEN}
    assert [account.measured is None for account in accounts] == [False, False] + [True] * len(others)
    first, second, third, *_ = lines(t11)
    accounts = account_edges(face([first, third], [1.0, 1.0], hidden=(second, third)), t11)
    assert [account.fate for account in accounts[:3]] == [EdgeFate.USED, EdgeFate.HIDDEN, EdgeFate.HIDDEN]


def test_a_line_of_which_one_stretch_is_hidden_counts_by_what_was_measured(t11: PalletModel) -> None:
    (line,) = (line for line in face_lines(t11) if line.kind is EdgeKind.OPENING_TOP)
    hidden = (line.edges[0],)
    for edges, weights, fate in (([line.whole], [1.0], EdgeFate.USED), ([], [], EdgeFate.HIDDEN)):
        accounts = account_edges(face(edges, weights, hidden=hidden), t11)
        assert next(account.fate for account in accounts if account.edge == line.whole) is fate


def test_from_below_a_beam_hides_and_from_above_a_load_may_begin(t11: PalletModel) -> None:
    kinds = {account.edge.kind for account in account_edges(face([], [], FROM_BELOW), t11)}
    assert EdgeKind.BOTTOM not in kinds
    assert EdgeKind.TOP in kinds
    for camera, loaded in ((FROM_ABOVE, {EdgeKind.TOP}), (FROM_BELOW, set())):
        accounts = account_edges(face([], [], camera), t11)
        assert {account.edge.kind for account in accounts if account.loaded} == loaded


def test_sigma_includes_the_rounding_of_the_edge(t11: PalletModel) -> None:
    account, *_, last = account_edges(face(lines(t11)[:1], [1.0]), t11)
    assert account.sigma == pytest.approx(0.005)
    assert np.isnan(last.sigma)


def test_names_tell_all_edges_of_a_face_apart() -> None:
    openings = tuple(Opening(center, 0.0, 0.2, 0.1) for center in (-0.3, 0.0, 0.3))
    model = PalletModel("three", 1.0, 0.144, 1.2, openings)
    names = [edge_name(model, edge) for edge in lines(model)]
    assert len(set(names)) == len(names)
    left = FaceEdge(EdgeKind.OPENING_SIDE, (-0.1, 0.0), (-0.1, 0.1), (1.0, 0.0))
    assert edge_name(model, left) == "opening 2, left side"


BASE = LevelPose(2.0, 1.5, 0.1, 1.4)
AXES = SearchAxes(BASE, 2.5, 1.8)
DEPTH = np.array([np.cos(BASE.yaw), np.sin(BASE.yaw)])
ALONG = np.array([-DEPTH[1], DEPTH[0]])


def moved(along_ray: float = 0.0, sideways: float = 0.0, turn: float = 0.0) -> LevelPose:
    """Return the base moved along a viewing ray on the ground that meets the face at an angle, and sideways."""
    obliquely = np.sqrt(AXES.away**2 - AXES.depth**2) / AXES.depth
    step = along_ray * AXES.depth / AXES.away * (DEPTH + obliquely * ALONG) + sideways * ALONG
    return replace(BASE, x=BASE.x + step[0], y=BASE.y + step[1], yaw=BASE.yaw + turn)


def test_turns_and_factors_become_yaws_and_distances_from_the_base_even_across_the_seam() -> None:
    assert AXES.place(BASE) == pytest.approx([BASE.yaw, 2.5])
    axes = replace(AXES, base=replace(BASE, yaw=3.1))
    assert axes.place(replace(BASE, yaw=-3.1))[0] == pytest.approx(2 * np.pi - 3.1)
    assert AXES.yaws(np.array([-0.1, 0.2])) == pytest.approx([1.3, 1.6])
    assert AXES.ranges(np.array([0.9, 1.2])) == pytest.approx([2.25, 3.0])


@given(st.floats(-1.0, 1.0), st.floats(-0.3, 0.3), st.floats(-3.0, 3.0))
def test_a_step_along_the_ray_changes_the_distance_and_one_sideways_does_not(
    along_ray: float, sideways: float, turn: float
) -> None:
    yaw, away = AXES.place(moved(along_ray, sideways, turn))
    assert yaw - BASE.yaw == pytest.approx(turn, abs=1e-9)
    assert away == pytest.approx(2.5 + along_ray)


def test_the_covariance_is_that_of_moved_places() -> None:
    rng = np.random.default_rng(1)
    factor = rng.normal(size=(4, 4)) * 1e-3
    drawn = BASE.as_array() + rng.normal(size=(20_000, 4)) @ factor.T
    places = np.array([AXES.place(LevelPose(*row)) for row in drawn])
    assert AXES.covariance(factor @ factor.T) == pytest.approx(np.cov(places.T), rel=0.06, abs=2e-7)


def test_names_run_from_left_to_right(floor_localizer: Makes, floor_shot: Shot, floor_pallets: Pallets) -> None:
    # the shelf is to the left: what is nearer ahead is farther to the right
    (left, _), (right, _) = sorted(floor_pallets, key=lambda placed: placed[1].x)
    starts = [Start(model.name, pose) for model, pose in reversed(floor_pallets)]
    named = dict(name_candidates(floor_localizer().explain_from(floor_shot, starts, (0.0,))))
    assert (named["P1"].candidate.model.name, named["P2"].candidate.model.name) == (left.name, right.name)


def test_what_was_given_up_has_own_names(floor_localizer: Makes, floor_shot: Shot, t11: PalletModel) -> None:
    shelf = ShelfPlane(1.0, 2.0, np.radians(-90.0), (0.0,))
    explained = floor_localizer(models=[t11]).explain(floor_shot, shelf)
    named = name_candidates(explained)
    assert len(named) == len(explained.outcomes) == len({name for name, _ in named})
    for name, outcome in named:
        assert name.startswith("P") == isinstance(outcome, Fit)
    scores = [outcome.candidate.score for name, outcome in named if name.startswith("C")]
    assert scores == sorted(scores, reverse=True)
