"""Which faces can be built, and bad files of them: one line with file, line or key, and what was expected."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc import Opening, PalletModel
from palletloc.pallet_library import PalletFileError, read_pallets
from tests.palletloc.poses import WritePallets

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


def test_an_opening_lies_between_its_sides_and_equal_models_are_one_key_of_a_cache() -> None:
    assert (LEFT.left, LEFT.right) == pytest.approx((-0.41, -0.11))
    assert (LEFT.bottom, LEFT.top) == pytest.approx((0.024, 0.114))
    assert {MODEL: 1}[replace(MODEL)] == 1


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
            (replace(LEFT, center=-0.162, bottom=0), replace(RIGHT, center=0.162, bottom=0)), id="middle block"
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


# Bad files.

FACE = "width_m: 1.1, height_m: 0.144, depth_m: 0.9"
OPENING = "{center_m: 0.1, bottom_m: 0.02, width_m: 0.3, height_m: 0.1}"
POCKETS = "{pocket_width_m: 0.3, center_width_m: 0.2, pocket_bottom_m: 0, pocket_height_m: 0.1}"
GOOD = f"mine: {{{FACE}, openings: [{OPENING}]}}\n"


def complaint(path: Path) -> str:
    with pytest.raises(PalletFileError) as caught:
        read_pallets(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message.removeprefix(str(path))


def test_what_is_no_file_is_named(tmp_path: Path) -> None:
    expected = "; expected a file of pallet models"
    assert complaint(tmp_path / "none.yaml") == f": No such file or directory{expected}"
    assert complaint(tmp_path) == f": Is a directory{expected}"


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        *(
            (text, ": the file is empty; expected pallet models by name")
            for text in ("", "# nothing\n", "---\n", "{}")
        ),
        ("- a\n- b\n", ": expected pallet models by name, got a list"),
        ("just words\n", ": expected pallet models by name, got 'just words'"),
        ("3\n", ": expected pallet models by name, got 3"),
        (GOOD.encode() + b"# caf\xe9\n", ", line 2: expected text in UTF-8"),
        (GOOD + GOOD, ", line 2: is not yaml: key 'mine' stands there twice"),
        (GOOD.replace("depth_m", "height_m"), ", line 1: is not yaml: key 'height_m' stands there twice"),
        (GOOD.replace("bottom_m", "width_m"), ", line 1: is not yaml: key 'width_m' stands there twice"),
        ("a: &a [*a]\n", ", line 1: is not yaml: '*a' stands for itself"),
    ],
)
def test_a_file_holds_models_by_name(pallet_file: WritePallets, content: str | bytes, problem: str) -> None:
    assert complaint(pallet_file(content)) == problem


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (GOOD + "other: {width_m: 1\n", ", line 3: is not yaml: "),
        (GOOD + "\tother: 1\n", ", line 2: is not yaml: "),
        (GOOD + "---\n" + GOOD, ", line 2: is not yaml: "),
        ("mine: *nothing\n", ", line 1: is not yaml: "),
        (GOOD + "\x01", ": is not yaml: "),
        ("? [a]\n: b\n", ", line 1: is not yaml: "),
        ("mine: {width_m: 2001-99-99}", ": is not yaml: "),
        (f"mine: {{width_m: {'9' * 5000}}}", ": mine.width_m: expected a finite number, got inf"),
        (GOOD + "a: !!python/object:os.system x\n", ", line 2: is not yaml: the tag "),
        ("mine: {width_m: !!timestamp x}\n", ", line 1: is not yaml: the tag "),
        ("[" * 100_000, ": is not yaml: nested too deeply"),
    ],
)
def test_malformed_yaml_is_refused(pallet_file: WritePallets, content: str, problem: str) -> None:
    assert complaint(pallet_file(content)).startswith(problem)


@pytest.mark.parametrize(
    ("name", "shown"), [("1200", "1200"), ("a/b", "'a/b'"), ("'a,b'", "'a,b'"), ("'a b'", "'a b'"), ("''", "''")]
)
def test_a_name_fits_into_a_table_and_a_file_name(pallet_file: WritePallets, name: str, shown: str) -> None:
    expected = f": {shown} is no name of a pallet model; expected letters, digits, '-', '_', '.'"
    assert complaint(pallet_file(GOOD.replace("mine", name, 1))) == expected


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("width_m: 1.1", "widht_m: 1.1", "mine: unknown key 'widht_m'; did you mean 'width_m'?"),
        ("center_m", "centre_m", "mine.openings[0]: unknown key 'centre_m'; did you mean 'center_m'?"),
        (f"openings: [{OPENING}]", "opening: []", "mine: unknown key 'opening'; did you mean 'openings'?"),
        ("width_m: 1.1", "1: 1.1", "mine: unknown key '1'; known are block_rows_m, confirmed, "),
        ("height_m: 0.144, ", "", "mine.height_m: the key is missing"),
        ("center_m: 0.1, ", "", "mine.openings[0].center_m: the key is missing"),
        ("depth_m: 0.9", "depth_m: wide", "mine.depth_m: expected a number, got 'wide'"),
        ("depth_m: 0.9", "depth_m: yes", "mine.depth_m: expected a number, got True"),
        ("depth_m: 0.9", "depth_m: null", "mine.depth_m: expected a number, got nothing"),
        ("depth_m: 0.9", "depth_m: [1]", "mine.depth_m: expected a number, got a list"),
        ("depth_m: 0.9", "depth_m: .nan", "mine.depth_m: expected a finite number, got nan"),
        ("depth_m: 0.9", "depth_m: nan", "mine.depth_m: expected a finite number, got nan"),
        ("depth_m: 0.9", "depth_m: -.inf", "mine.depth_m: expected a finite number, got -inf"),
        ("bottom_m: 0.02", "bottom_m: .nan", "mine.openings[0].bottom_m: expected a finite number, got nan"),
        ("depth_m: 0.9", "depth_m: 900", "mine.depth_m: expected metres, at most 10, got 900"),
        ("depth_m: 0.9", "depth_m: -900", "mine.depth_m: expected metres, at least -10, got -900"),
        ("depth_m: 0.9", f"depth_m: 0x{'f' * 5000}", "mine.depth_m: expected a number, got '0xfff"),
        ("depth_m: 0.9", "depth_m: 0.9, confirmed: 1", "mine.confirmed: expected true or false, got 1"),
        ("depth_m: 0.9", "depth_m: 0.9, source: 7", "mine.source: expected text, got 7"),
        (f"[{OPENING}]", "3", "mine.openings: expected a list, got 3"),
        (OPENING, "3", "mine.openings[0]: expected a mapping of keys to values, got 3"),
        (f"{{{FACE}, openings: [{OPENING}]}}", "3", "mine: expected a mapping of keys to values, got 3"),
        (OPENING, "", "mine: the face has no opening for the forks"),
        (f", openings: [{OPENING}]", "", "mine: expected one of the keys 'openings' and 'parametric', got none"),
        (
            "openings:",
            f"parametric: {POCKETS}, openings:",
            "mine: expected one of the keys 'openings' and 'parametric', got both",
        ),
        (
            f"openings: [{OPENING}]",
            f"parametric: {POCKETS.replace('pocket_height_m', 'pocket_hight_m')}",
            "mine.parametric: unknown key 'pocket_hight_m'; did you mean 'pocket_height_m'?",
        ),
        (
            f"openings: [{OPENING}]",
            f"parametric: {POCKETS.replace('pocket_height_m: 0.1', 'pocket_height_m: -0.1')}",
            "mine.parametric: the opening's height must be positive, got -0.1 m",
        ),
        (
            f"openings: [{OPENING}]",
            f"parametric: {POCKETS.replace('center_width_m: 0.2', 'center_width_m: 0')}",
            "mine: openings 1 and 2 overlap or touch: ",
        ),
        ("width_m: 0.3", "width_m: 0", "mine.openings[0]: the opening's width must be positive, got 0 m"),
        (
            "center_m: 0.1",
            "center_m: 0.5",
            "mine: opening 1 spans 0.35 to 0.65 m, expected inside the face's -0.55 to 0.55 m",
        ),
        ("depth_m: 0.9", "depth_m: 0.9, block_rows_m: 3", "mine.block_rows_m: expected a list, got 3"),
        ("depth_m: 0.9", "depth_m: 0.9, block_rows_m: [3]", "mine.block_rows_m[0]: expected a list, got 3"),
        (
            "depth_m: 0.9",
            "depth_m: 0.9, block_rows_m: [[0, a]]",
            "mine.block_rows_m[0][1]: expected a number, got 'a'",
        ),
        ("depth_m: 0.9", "depth_m: 0.9, block_rows_m: [[0]]", "mine.block_rows_m[0][1]: the value is missing"),
        (
            "depth_m: 0.9",
            "depth_m: 0.9, block_rows_m: [[0, 0.1, 0.2]]",
            "mine.block_rows_m[0]: expected two numbers, ",
        ),
        (
            "depth_m: 0.9",
            "depth_m: 0.9, block_rows_m: [[0, 1.2]]",
            "mine: rows of blocks at 0, 1.2 m, expected rising",
        ),
        (
            "depth_m: 0.9",
            "depth_m: 0.9, block_row_m: []",
            "mine: unknown key 'block_row_m'; did you mean 'block_rows_m'?",
        ),
        ("depth_m: 0.9", "depth_m: 0", "mine: the face's depth must be positive, got 0 m"),
    ],
)
def test_a_wrong_key_or_value_is_named(pallet_file: WritePallets, old: str, new: str, problem: str) -> None:
    content = GOOD.replace(old, new, 1)
    assert content != GOOD
    assert complaint(pallet_file(content)).startswith(f": {problem}")


def test_a_misspelt_key_is_named_before_the_missing_one(pallet_file: WritePallets) -> None:
    content = GOOD.replace("depth_m", "deepth_m").replace("height_m: 0.144, ", "")
    assert complaint(pallet_file(content)).startswith(": mine: unknown key 'deepth_m'")
