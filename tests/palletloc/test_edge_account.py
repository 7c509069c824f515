from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from palletloc.edge_account import EdgeFate, account_edges, edge_name
from palletloc.edge_fit import EdgeFit
from palletloc.face import EdgeKind, EdgeShift, FaceEdge, face_lines
from palletloc.pallet import Opening, PalletModel
from palletloc.refinement.edges import MeasuredEdge, SeenFace

FROM_ABOVE, FROM_BELOW = np.array([0.2, 1.2, 2.0]), np.array([0.2, -0.6, 2.0])


def measured(edge: FaceEdge) -> MeasuredEdge:
    return MeasuredEdge(edge, EdgeFit(0.002, 0.0, 1e-3, 1e-3, 0.9, 20.0), 0.003, EdgeShift(0.0, 0.004, True), 0.004)


def face(edges: list[FaceEdge], weights: list[float], camera: Any = FROM_ABOVE, **fields: Any) -> Any:
    """Return what stands for a fit: its edges and their weights."""
    seen = SeenFace(camera, tuple(measured(edge) for edge in edges), expected=len(edges))
    return SimpleNamespace(seen=seen, weights=np.array(weights), **({"hidden": ()} | fields))


def lines(model: PalletModel) -> list[FaceEdge]:
    return [line.whole for line in face_lines(model)]


def test_every_line_has_one_entry_with_its_fate(t11: PalletModel) -> None:
    used, rejected, *others = lines(t11)
    accounts = account_edges(face([used, rejected], [0.9, 0.1]), t11)
    assert [one.edge for one in accounts] == [used, rejected, *others]
    assert [one.number for one in accounts] == list(range(1, len(accounts) + 1))
    assert [one.fate for one in accounts[:2]] == [EdgeFate.USED, EdgeFate.REJECTED]
    assert {one.fate for one in accounts[2:]} == {EdgeFate.NOT_SEEN}
    assert [one.measured is None for one in accounts] == [False, False] + [True] * len(others)


def test_hidden_edges_are_told_from_those_that_are_not_seen(t11: PalletModel) -> None:
    first, second, third, *_ = lines(t11)
    accounts = account_edges(face([first, third], [1.0, 1.0], hidden=(second, third)), t11)
    assert [one.fate for one in accounts[:3]] == [EdgeFate.USED, EdgeFate.HIDDEN, EdgeFate.HIDDEN]


def test_a_line_of_which_one_stretch_is_hidden_counts_by_what_was_measured(t11: PalletModel) -> None:
    (line,) = (line for line in face_lines(t11) if line.kind is EdgeKind.OPENING_TOP)
    hidden = (line.edges[0],)
    for edges, weights, fate in (([line.whole], [1.0], EdgeFate.USED), ([], [], EdgeFate.HIDDEN)):
        accounts = account_edges(face(edges, weights, hidden=hidden), t11)
        assert next(one.fate for one in accounts if one.edge == line.whole) is fate


def test_what_a_beam_hides_from_below_is_not_expected(t11: PalletModel) -> None:
    kinds = {one.edge.kind for one in account_edges(face([], [], FROM_BELOW), t11)}
    assert EdgeKind.BOTTOM not in kinds
    assert EdgeKind.TOP in kinds


def test_a_load_may_begin_at_the_upper_edge_seen_from_above(t11: PalletModel) -> None:
    for camera, loaded in ((FROM_ABOVE, {EdgeKind.TOP}), (FROM_BELOW, set())):
        accounts = account_edges(face([], [], camera), t11)
        assert {one.edge.kind for one in accounts if one.loaded} == loaded


def test_sigma_includes_the_rounding_of_the_edge(t11: PalletModel) -> None:
    one, *_, last = account_edges(face(lines(t11)[:1], [1.0]), t11)
    assert one.sigma == pytest.approx(0.005)
    assert np.isnan(last.sigma)


def test_names_tell_all_edges_of_a_face_apart() -> None:
    openings = tuple(Opening(center, 0.0, 0.2, 0.1) for center in (-0.3, 0.0, 0.3))
    model = PalletModel("three", 1.0, 0.144, 1.2, openings)
    names = [edge_name(model, edge) for edge in lines(model)]
    assert len(set(names)) == len(names)
    left = FaceEdge(EdgeKind.OPENING_SIDE, (-0.1, 0.0), (-0.1, 0.1), (1.0, 0.0))
    assert edge_name(model, left) == "opening 2, left side"
