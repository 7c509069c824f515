from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc.candidate import Fit
from palletloc.edge_fit import EdgeFit
from palletloc.explained import EdgeFate, SearchAxes, account_edges, edge_name, name_candidates
from palletloc.face import EdgeKind, EdgeShift, FaceEdge, face_lines
from palletloc.geometry import LevelPose
from palletloc.localizer import Localizer, Start
from palletloc.pallet import Opening, PalletModel
from palletloc.refinement.edges import MeasuredEdge, SeenFace
from palletloc.shelf import ShelfPlane
from palletloc.shot import Shot

Placed = tuple[PalletModel, LevelPose]


FROM_ABOVE, FROM_BELOW = np.array([0.2, 1.2, 2.0]), np.array([0.2, -0.6, 2.0])


def measured(edge: FaceEdge) -> MeasuredEdge:
    fit, shift = EdgeFit(0.002, 0.0, 1e-3, 1e-3, 0.9, 20.0), EdgeShift(0.0, 0.004, True)
    return MeasuredEdge(edge, fit, 0.003, shift, 0.004, 1.0)


def face(edges: list[FaceEdge], weights: list[float], camera: Any = FROM_ABOVE, **fields: Any) -> Any:
    """Return what stands for a fit: its edges and their weights."""
    seen = SeenFace(camera, np.eye(4), (), tuple(measured(edge) for edge in edges), expected=len(edges))
    return SimpleNamespace(seen=seen, weights=np.array(weights), **({"hidden": ()} | fields))


def lines(model: PalletModel) -> list[FaceEdge]:
    return [line.whole for line in face_lines(model)]


def test_every_line_has_one_entry_with_its_fate(t11: PalletModel) -> None:
    used, rejected, *others = lines(t11)
    accounts = account_edges(face([used, rejected], [0.9, 0.1]), t11)
    assert [account.edge for account in accounts] == [used, rejected, *others]
    assert [account.number for account in accounts] == list(range(1, len(accounts) + 1))
    assert [account.fate for account in accounts[:2]] == [EdgeFate.USED, EdgeFate.REJECTED]
    assert {account.fate for account in accounts[2:]} == {EdgeFate.NOT_SEEN}
    assert [account.measured is None for account in accounts] == [False, False] + [True] * len(others)


def test_hidden_edges_are_told_from_those_that_are_not_seen(t11: PalletModel) -> None:
    first, second, third, *_ = lines(t11)
    accounts = account_edges(face([first, third], [1.0, 1.0], hidden=(second, third)), t11)
    assert [account.fate for account in accounts[:3]] == [EdgeFate.USED, EdgeFate.HIDDEN, EdgeFate.HIDDEN]


def test_a_line_of_which_one_stretch_is_hidden_counts_by_what_was_measured(t11: PalletModel) -> None:
    (line,) = (line for line in face_lines(t11) if line.kind is EdgeKind.OPENING_TOP)
    hidden = (line.edges[0],)
    for edges, weights, fate in (([line.whole], [1.0], EdgeFate.USED), ([], [], EdgeFate.HIDDEN)):
        accounts = account_edges(face(edges, weights, hidden=hidden), t11)
        assert next(account.fate for account in accounts if account.edge == line.whole) is fate


def test_what_a_beam_hides_from_below_is_not_expected(t11: PalletModel) -> None:
    kinds = {account.edge.kind for account in account_edges(face([], [], FROM_BELOW), t11)}
    assert EdgeKind.BOTTOM not in kinds
    assert EdgeKind.TOP in kinds


def test_a_load_may_begin_at_the_upper_edge_seen_from_above(t11: PalletModel) -> None:
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


def test_the_base_is_in_its_place() -> None:
    assert AXES.place(BASE) == pytest.approx([BASE.yaw, 2.5])


@given(st.floats(-1.0, 1.0), st.floats(-0.3, 0.3), st.floats(-3.0, 3.0))
def test_a_step_along_the_ray_changes_the_distance_and_one_sideways_does_not(
    along_ray: float, sideways: float, turn: float
) -> None:
    yaw, away = AXES.place(moved(along_ray, sideways, turn))
    assert yaw - BASE.yaw == pytest.approx(turn, abs=1e-9)
    assert away == pytest.approx(2.5 + along_ray)


def test_a_yaw_across_the_seam_stays_next_to_the_bases() -> None:
    axes = replace(AXES, base=replace(BASE, yaw=3.1))
    assert axes.place(replace(BASE, yaw=-3.1))[0] == pytest.approx(2 * np.pi - 3.1)


def test_the_covariance_is_that_of_moved_places() -> None:
    rng = np.random.default_rng(1)
    factor = rng.normal(size=(4, 4)) * 1e-3
    drawn = BASE.as_array() + rng.normal(size=(20_000, 4)) @ factor.T
    places = np.array([AXES.place(LevelPose(*row)) for row in drawn])
    assert AXES.covariance(factor @ factor.T) == pytest.approx(np.cov(places.T), rel=0.06, abs=2e-7)


def test_turns_and_factors_become_yaws_and_distances() -> None:
    assert AXES.yaws(np.array([-0.1, 0.2])) == pytest.approx([1.3, 1.6])
    assert AXES.ranges(np.array([0.9, 1.2])) == pytest.approx([2.25, 3.0])


def test_pallets_are_named_from_left_to_right(
    floor_localizer: Callable[..., Localizer], floor_shot: Shot, floor_pallets: tuple[Placed, ...]
) -> None:
    # the shelf is to the left: what is nearer ahead is farther to the right
    (left, _), (right, _) = sorted(floor_pallets, key=lambda placed: placed[1].x)
    starts = [Start(model.name, pose) for model, pose in reversed(floor_pallets)]
    explained = floor_localizer().explain_from(floor_shot, starts, (0.0,))
    named = dict(name_candidates(explained))
    assert (named["P1"].candidate.model.name, named["P2"].candidate.model.name) == (left.name, right.name)


def test_what_was_given_up_has_names_of_its_own(
    floor_localizer: Callable[..., Localizer], floor_shot: Shot, t11: PalletModel
) -> None:
    shelf = ShelfPlane(1.0, 2.0, np.radians(-90.0), (0.0,))
    explained = floor_localizer(models=[t11]).explain(floor_shot, shelf)
    named = name_candidates(explained)
    assert len(named) == len(explained.outcomes) == len({name for name, _ in named})
    for name, outcome in named:
        assert name.startswith("P") == isinstance(outcome, Fit)
    scores = [outcome.candidate.score for name, outcome in named if name.startswith("C")]
    assert scores == sorted(scores, reverse=True)
