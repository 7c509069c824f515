from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc.pallet import Opening, PalletModel

LEFT = Opening(center=-0.26, bottom=0.024, width=0.30, height=0.09, radius=0.01)
RIGHT = Opening(center=0.26, bottom=0.024, width=0.30, height=0.09, radius=0.01)
MODEL = PalletModel("mine", width=1.1, height=0.144, depth=1.1, openings=(LEFT, RIGHT), edge_radius=0.01)

LENGTHS = {
    "opening": ["center", "bottom", "width", "height", "radius"],
    "face": ["width", "height", "depth", "tolerance", "corner_radius", "edge_radius"],
}
not_finite = st.sampled_from([float("nan"), float("inf"), -float("inf")])
shares = st.lists(st.floats(0.05, 1.0), min_size=3, max_size=9).filter(lambda cuts: len(cuts) % 2 == 1)


def model_of_parts(parts: list[float], bottom: float = 0.02) -> PalletModel:
    """Return a face whose parts alternate: block, opening, ..., block."""
    cuts = np.cumsum([0.0, *parts]) - sum(parts) / 2
    openings = tuple(
        Opening(center=(left + right) / 2, bottom=bottom, width=right - left, height=0.1)
        for left, right in list(pairwise(cuts.tolist()))[1::2]
    )
    return PalletModel("parts", width=sum(parts), height=0.15, depth=1.0, openings=openings)


def test_an_opening_lies_between_its_sides() -> None:
    assert (LEFT.left, LEFT.right) == pytest.approx((-0.41, -0.11))
    assert (LEFT.bottom, LEFT.top) == pytest.approx((0.024, 0.114))


@pytest.mark.parametrize(("bottom", "is_open"), [(0.0, True), (0.001, False)])
def test_only_an_opening_that_begins_at_the_floor_is_open(bottom: float, is_open: bool) -> None:
    assert replace(LEFT, bottom=bottom).open_below is is_open


@given(shares)
def test_blocks_are_what_the_openings_leave(parts: list[float]) -> None:
    widths = [right - left for left, right in model_of_parts(parts).blocks]
    assert widths == pytest.approx(parts[::2])


@given(shares)
def test_blocks_and_openings_cover_the_face(parts: list[float]) -> None:
    model = model_of_parts(parts)
    cuts = [side for block in model.blocks for side in block]
    assert cuts == sorted(cuts)
    assert (cuts[0], cuts[-1]) == pytest.approx((-model.width / 2, model.width / 2))


def test_equal_models_are_one_key_of_a_cache() -> None:
    assert {MODEL: 1}[replace(MODEL)] == 1


@given(not_finite)
def test_all_lengths_are_finite(value: float) -> None:
    for part, what in ((LEFT, "opening"), (MODEL, "face")):
        for field in LENGTHS[what]:
            change: dict[str, Any] = {field: value}
            with pytest.raises(ValueError, match=f"the {what}'s {field} must be a finite number"):
                replace(part, **change)


@pytest.mark.parametrize("value", [0.0, -0.1])
def test_an_opening_and_a_face_have_a_size_and_a_face_a_tolerance(value: float) -> None:
    for part, what, names in ((LEFT, "opening", "width height"), (MODEL, "face", "width height depth tolerance")):
        for field in names.split():
            change: dict[str, Any] = {field: value}
            with pytest.raises(ValueError, match=f"the {what}'s {field} must be positive"):
                replace(part, **change)


def test_neither_radii_nor_the_place_above_the_floor_are_negative() -> None:
    for part, names in ((LEFT, "bottom radius"), (MODEL, "corner_radius edge_radius")):
        for field in names.split():
            change: dict[str, Any] = {field: -0.001}
            with pytest.raises(ValueError, match=f"{field} must not be negative"):
                replace(part, **change)


@pytest.mark.parametrize(
    ("openings", "problem"),
    [
        ((), "no opening"),
        *(((replace(LEFT, center=x), RIGHT), r"opening 1 spans .* expected inside") for x in (-0.40, -0.45, -0.9)),
        *(((LEFT, replace(RIGHT, center=x)), r"opening 2 spans .* expected inside") for x in (0.40, 0.45, 0.9)),
        *(((LEFT, replace(RIGHT, height=h)), r"opening 2 reaches up to .* expected below") for h in (0.12, 0.2)),
        *(((LEFT, replace(RIGHT, center=x)), "openings 1 and 2 overlap or touch") for x in (0.04, 0.0, -0.2)),
        ((RIGHT, LEFT), "opening 2 is not to the right of opening 1"),
    ],
)
def test_blocks_stand_around_the_openings_and_a_deck_lies_above(openings: tuple[Opening, ...], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        replace(MODEL, openings=openings)


def test_openings_and_faces_are_as_large_as_their_corners() -> None:
    replace(LEFT, radius=LEFT.height / 2)
    with pytest.raises(ValueError, match=r"the opening's corner radius .* half of its smaller side, 0\.09 m"):
        replace(LEFT, radius=LEFT.height / 2 + 0.001)
    replace(MODEL, corner_radius=MODEL.height / 2)
    with pytest.raises(ValueError, match=r"the face's corner radius .* half of its smaller side, 0\.144 m"):
        replace(MODEL, corner_radius=MODEL.height / 2 + 0.001)


@pytest.mark.parametrize(
    "openings",
    [
        pytest.param((LEFT, RIGHT), id="bottom board"),
        pytest.param((replace(LEFT, bottom=0.030), replace(RIGHT, bottom=0.030)), id="deck"),
        pytest.param(
            (replace(LEFT, center=-0.162, bottom=0), replace(RIGHT, center=0.162, bottom=0)),
            id="middle block",
        ),
        pytest.param((replace(LEFT, center=-0.376, bottom=0), replace(RIGHT, bottom=0)), id="outer block"),
    ],
)
def test_no_part_is_thinner_than_its_rounded_edges(openings: tuple[Opening, ...]) -> None:
    model = replace(MODEL, openings=openings)  # 24 mm in each case
    replace(model, edge_radius=0.012)
    with pytest.raises(ValueError, match=r"half of the thinnest part, 0\.024 m"):
        replace(model, edge_radius=0.0121)


@pytest.mark.parametrize("rows", [(), ((0.0, 0.1),), ((0.0, 0.1), (0.45, 0.55), (1.0, 1.1))])
def test_rows_of_blocks_stand_one_behind_the_other(rows: tuple[tuple[float, float], ...]) -> None:
    assert replace(MODEL, block_rows=rows).block_rows == rows


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        (((0.1, 0.2),), "row 1 of blocks begins 0.1 m behind the face, expected 0"),
        (((0.0, 0.0),), "expected rising values"),
        (((0.0, 0.1), (0.1, 0.2)), "expected rising values"),
        (((0.0, 0.1), (0.3, 0.2)), "expected rising values"),
        (((0.0, 0.5), (0.4, 0.6)), "expected rising values"),
        (((0.0, 0.1), (1.0, 1.2)), "rows of blocks at 0, 0.1, 1, 1.2 m, expected .* up to the depth of 1.1 m"),
        (((0.0, float("nan")),), "row 1 of blocks's back must be a finite number, got nan"),
    ],
)
def test_rows_that_cannot_be_built_are_refused(rows: tuple[tuple[float, float], ...], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        replace(MODEL, block_rows=rows)
