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
@pytest.mark.parametrize("field", ["center", "bottom", "width", "height", "radius"])
def test_an_opening_is_finite(field: str, value: float) -> None:
    change: dict[str, Any] = {field: value}
    with pytest.raises(ValueError, match=f"the opening's {field} must be a finite number"):
        replace(LEFT, **change)


@given(not_finite)
@pytest.mark.parametrize("field", ["width", "height", "depth", "tolerance", "corner_radius", "edge_radius"])
def test_a_face_is_finite(field: str, value: float) -> None:
    change: dict[str, Any] = {field: value}
    with pytest.raises(ValueError, match=f"the face's {field} must be a finite number"):
        replace(MODEL, **change)


@pytest.mark.parametrize("value", [0.0, -0.1])
@pytest.mark.parametrize("field", ["width", "height"])
def test_an_opening_has_a_size(field: str, value: float) -> None:
    change: dict[str, Any] = {field: value}
    with pytest.raises(ValueError, match=f"the opening's {field} must be positive"):
        replace(LEFT, **change)


@pytest.mark.parametrize("value", [0.0, -0.1])
@pytest.mark.parametrize("field", ["width", "height", "depth", "tolerance"])
def test_a_face_has_a_size_and_a_tolerance(field: str, value: float) -> None:
    change: dict[str, Any] = {field: value}
    with pytest.raises(ValueError, match=f"the face's {field} must be positive"):
        replace(MODEL, **change)


@pytest.mark.parametrize("field", ["bottom", "radius"])
def test_an_opening_does_not_begin_below_the_floor(field: str) -> None:
    change: dict[str, Any] = {field: -0.001}
    with pytest.raises(ValueError, match=f"{field} must not be negative"):
        replace(LEFT, **change)


@pytest.mark.parametrize("field", ["corner_radius", "edge_radius"])
def test_the_radii_of_a_face_are_not_negative(field: str) -> None:
    change: dict[str, Any] = {field: -0.001}
    with pytest.raises(ValueError, match=f"{field} must not be negative"):
        replace(MODEL, **change)


def test_a_face_has_an_opening() -> None:
    with pytest.raises(ValueError, match="no opening"):
        replace(MODEL, openings=())


@pytest.mark.parametrize("center", [-0.40, -0.45, -0.9])
def test_a_block_stands_left_of_the_openings(center: float) -> None:
    with pytest.raises(ValueError, match=r"opening 1 spans .* expected inside"):
        replace(MODEL, openings=(replace(LEFT, center=center), RIGHT))


@pytest.mark.parametrize("center", [0.40, 0.45, 0.9])
def test_a_block_stands_right_of_the_openings(center: float) -> None:
    with pytest.raises(ValueError, match=r"opening 2 spans .* expected inside"):
        replace(MODEL, openings=(LEFT, replace(RIGHT, center=center)))


@pytest.mark.parametrize("height", [0.12, 0.2])
def test_a_deck_lies_above_the_openings(height: float) -> None:
    with pytest.raises(ValueError, match=r"opening 2 reaches up to .* expected below"):
        replace(MODEL, openings=(LEFT, replace(RIGHT, height=height)))


def test_openings_are_in_order() -> None:
    with pytest.raises(ValueError, match="opening 2 is not to the right of opening 1"):
        replace(MODEL, openings=(RIGHT, LEFT))


@pytest.mark.parametrize("center", [0.04, 0.0, -0.2])
def test_a_block_stands_between_the_openings(center: float) -> None:
    with pytest.raises(ValueError, match="openings 1 and 2 overlap or touch"):
        replace(MODEL, openings=(LEFT, replace(RIGHT, center=center)))


def test_an_opening_is_as_large_as_its_corners() -> None:
    replace(LEFT, radius=LEFT.height / 2)
    with pytest.raises(ValueError, match=r"the opening's corner radius .* half of its smaller side, 0\.09 m"):
        replace(LEFT, radius=LEFT.height / 2 + 0.001)


def test_a_face_is_as_large_as_its_corners() -> None:
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
