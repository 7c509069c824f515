"""Bad files: one line that names the file, the line or key, and what was expected."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from palletloc.pallet_library import PalletFileError, read_pallets

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
        (GOOD + GOOD, ", line 2: the key 'mine' is repeated"),
        (GOOD.replace("depth_m", "height_m"), ", line 1: the key 'height_m' is repeated"),
        (GOOD.replace("bottom_m", "width_m"), ", line 1: the key 'width_m' is repeated"),
        ("a: &a [*a]\n", ": a: expected a mapping of keys to values, got a list"),
    ],
)
def test_a_file_holds_models_by_name(
    pallet_file: Callable[[str | bytes], Path], content: str | bytes, problem: str
) -> None:
    assert complaint(pallet_file(content)) == problem


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (GOOD + "other: {width_m: 1\n", ", line 3: not valid YAML: "),
        (GOOD + "\tother: 1\n", ", line 2: not valid YAML: "),
        (GOOD + "---\n" + GOOD, ", line 2: not valid YAML: "),
        ("mine: *nothing\n", ", line 1: not valid YAML: "),
        (GOOD + "\x01", ": not valid YAML: "),
        ("? [a]\n: b\n", ", line 1: not valid YAML: "),
        ("mine: {width_m: 2001-99-99}", ": not valid YAML: "),
        (f"mine: {{width_m: {'9' * 5000}}}", ": not valid YAML: "),
        (GOOD + "a: !!python/object:os.system x\n", ", line 2: a tag is not understood"),
        ("mine: {width_m: !!timestamp x}\n", ", line 1: a tag is not understood"),
        ("[" * 100_000, ", line 1: "),
    ],
)
def test_malformed_yaml_is_refused(pallet_file: Callable[[str], Path], content: str, problem: str) -> None:
    assert complaint(pallet_file(content)).startswith(problem)


@pytest.mark.parametrize(
    ("name", "shown"),
    [("1200", "1200"), ("a/b", "'a/b'"), ("'a,b'", "'a,b'"), ("'a b'", "'a b'"), ("''", "''")],
)
def test_a_name_fits_into_a_table_and_a_file_name(pallet_file: Callable[[str], Path], name: str, shown: str) -> None:
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
        ("depth_m: 0.9", f"depth_m: 0x{'f' * 5000}", "mine.depth_m: expected a number, got a huge number"),
        ("depth_m: 0.9", "depth_m: 0.9, confirmed: 1", "mine.confirmed: expected true or false, got 1"),
        ("depth_m: 0.9", "depth_m: 0.9, source: 7", "mine.source: expected text, got 7"),
        (f"[{OPENING}]", "3", "mine.openings: expected a list, got 3"),
        (OPENING, "3", "mine.openings[0]: expected a mapping of keys to values, got 3"),
        (f"{{{FACE}, openings: [{OPENING}]}}", "3", "mine: expected a mapping of keys to values, got 3"),
        (OPENING, "", "mine: the face has no opening for the forks"),
        (
            f", openings: [{OPENING}]",
            "",
            "mine: expected one of the keys 'openings' and 'parametric', got none",
        ),
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
        (
            "width_m: 0.3",
            "width_m: 0",
            "mine.openings[0]: the opening's width must be positive, got 0 m",
        ),
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
def test_a_wrong_key_or_value_is_named(pallet_file: Callable[[str], Path], old: str, new: str, problem: str) -> None:
    content = GOOD.replace(old, new, 1)
    assert content != GOOD
    assert complaint(pallet_file(content)).startswith(f": {problem}")


def test_a_misspelt_key_is_named_before_the_missing_one(pallet_file: Callable[[str], Path]) -> None:
    content = GOOD.replace("depth_m", "deepth_m").replace("height_m: 0.144, ", "")
    assert complaint(pallet_file(content)).startswith(": mine: unknown key 'deepth_m'")
