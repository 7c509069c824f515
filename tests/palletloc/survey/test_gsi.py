import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palletloc.io.reading import InputError
from palletloc.survey.gsi import (
    ANGLE_UNITS,
    LENGTH_UNITS,
    GsiBlock,
    GsiLineError,
    GsiWord,
    Kind,
    WordError,
    parse_gsi,
    parse_line,
    read_gsi,
)
from palletloc.survey.gsi_points import read_gsi_points
from palletloc.survey.point import SurveyError
from tests.palletloc.survey.gsi_writer import format_block, measured_word, point_block, text_word, write_gsi

# Lines of real instruments.
REAL = [
    "110001+00000001 21.322+03496940 22.322+09364360 31..00+00030485 51..1.+0000+000 87..10+00001500 "
    "81..00+00515836 82..00+00525871 83..00+00003079 71....+00000001 32..10+00030333 ",
    "*110002+00000000GDEM5415 21.024+0000000003545100 22.024+0000000009117510 31...0+0000000000013825 "
    "51....+000000000017+000 87...0+0000000000001300 88...0+0000000000001324 ",
    "*410004+0000000000000021 42....+000000000000BP04 43....+0000000000001538 ",
    "*110015+000000000000BP03 21.322+0000000016901313 22.322+0000000009955914 31..00+0000000000029462 "
    "51..1.+00000008+0000000 71....+00000000000----- ",
    "110003+0000000G 32...8+02275233 331.08+00126139 390...+00000003 391.08+00000004 ",
    "410001+?......2 ",
]
TEXT = "\n".join(REAL)


@pytest.mark.parametrize("line", REAL)
def test_a_real_line_is_read_and_written_byte_by_byte_with_and_without_a_blank_at_its_end(line: str) -> None:
    block = parse_line(line, 3)
    assert format_block(block) == line
    assert parse_line(format_block(block), 3) == block
    bare = parse_line(line.rstrip())
    assert bare.words == block.words
    assert format_block(bare) == line.rstrip()


def test_values_of_a_real_line() -> None:
    block = parse_line(REAL[0])
    values = {index: word.measure() for index in ("31", "81", "82", "83", "87") if (word := block.word(index))}
    assert values == {"31": 30.485, "81": 515.836, "82": 525.871, "83": 3.079, "87": 1.5}
    assert [word.index for word in parse_line(REAL[4]).words] == ["11", "32", "331", "390", "391"]


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r", "\r\r\n", "\n\n"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_any_line_ending_and_a_byte_order_mark_are_read(tmp_path: Path, ending: str, mark: bytes) -> None:
    path = tmp_path / "a.gsi"
    path.write_bytes(mark + ending.join(REAL).encode())
    file = read_gsi(path)
    assert [format_block(block) for block in file.blocks] == REAL
    assert file.rejected == ()


def test_utf_16_and_other_alphabets_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.gsi"
    path.write_bytes(TEXT.encode("utf-16"))
    assert len(read_gsi(path).blocks) == len(REAL)
    path.write_bytes(REAL[0].replace("71....+00000001", "71....+0000H\u00f6he").encode("latin-1"))
    word = read_gsi(path).blocks[0].word("71")
    assert word
    assert word.text == "H\u00f6he"


def test_dashes_are_no_value_and_noted_with_line_and_word() -> None:
    file = parse_gsi(Path("a.gsi"), TEXT.replace("31..00+00030485", "31..00+--------"))
    assert len(file.blocks) == len(REAL)
    assert [(note.line, note.text) for note in file.notes] == [(1, "word 31 has no value, its data are '--------'")]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("hello", "column 1: expected a word as '31..00\\+00030485', got 'hello'"),
        ("* ", "has no words"),
        ("21.322+03496940 ", "starts with word 21, expected a point"),
        ("110001+00000001 31..00+000304", "column 17: word 31 has 6 of 8 characters of data"),
        ("110001+00000001 31..00 00030485", "column 17: expected a word"),
        ("*110001+00000001 31..00+00030485", "column 25: expected a blank after word 11, got '0'|expected a word"),
        ("110001+0000000000000001 31..00+0000000000030485", "the line has no '\\*' for words of 16 characters"),
        ("110001+00000001 31..00+00000001 31..00+00000002", "word 31 stands there twice"),
    ],
)
def test_a_bad_line_is_listed_with_number_and_reason(line: str, said: str) -> None:
    with pytest.raises(GsiLineError, match=said):
        parse_line(line)
    file = parse_gsi(Path("a.gsi"), f"{REAL[0]}\n\n{line}\n{REAL[1]}")
    assert [block.line for block in file.blocks] == [1, 4]
    assert [note.line for note in file.rejected] == [3]


@settings(max_examples=100)
@given(place=st.integers(0, len(TEXT) - 1), cut=st.integers(0, 30), put=st.text("0123456789+-. *A\r\n\t", max_size=4))
def test_whatever_is_done_to_a_file_each_line_is_read_or_listed(place: int, cut: int, put: str) -> None:
    text = TEXT[:place] + put + TEXT[place + cut :]
    try:
        file = parse_gsi(Path("a.gsi"), text)
    except SurveyError:
        return
    seen = [block.line for block in file.blocks] + [note.line for note in file.rejected]
    lines = re.split(r"\r*\n|\r", text)
    assert sorted(seen) == [number for number, line in enumerate(lines, start=1) if line.strip()]
    for block in file.blocks:
        assert parse_line(format_block(block), block.line) == block


def test_a_file_of_another_kind_is_an_error(tmp_path: Path) -> None:
    for content, said in (
        (b"", r"a\.gsi: is empty; expected lines in GSI form"),
        (b"name,x_m,y_m,z_m\nA,1,2,3\n", r"a\.gsi, line 1: column 1: expected a word"),
        (b"11\0", "zero bytes"),
    ):
        (tmp_path / "a.gsi").write_bytes(content)
        with pytest.raises(InputError, match=said):
            read_gsi(tmp_path / "a.gsi")
    assert issubclass(SurveyError, InputError)


@pytest.mark.parametrize("name", ["dna_level", "tps_mixed_units", "two_faces"])
def test_every_line_of_the_real_files_is_read_or_listed(shared_data: Path, name: str) -> None:
    path = shared_data / "gsi" / f"{name}.gsi"
    lines = path.read_text().splitlines()
    file = read_gsi(path)
    seen = [block.line for block in file.blocks] + [note.line for note in file.rejected]
    assert sorted(seen) == [number for number, line in enumerate(lines, start=1) if line.strip()]
    assert [format_block(block) for block in file.blocks] == [lines[block.line - 1] for block in file.blocks]
    assert len(file.blocks) > 0.99 * len(seen)


def word(text: str) -> GsiWord:
    return parse_line(f"{'*' if len(text) == 23 else ''}110001+{'1'.rjust(len(text) - 7, '0')} {text}").words[1]


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("31..00+00030485", 30.485),
        ("31..01+00030485", 30.485 * 0.3048),
        ("31..06+00030485", 3.0485),
        ("31..07+00030485", 3.0485 * 0.3048),
        ("31..08+00030485", 0.30485),
        ("81..06-0000000000068507", -6.8507),
        ("331.08+00126139", 1.26139),
        ("573..8-00056496", -0.56496),
    ],
)
def test_the_unit_digit_alone_scales_a_length(text: str, metres: float) -> None:
    assert word(text).measure() == pytest.approx(metres, rel=1e-15)


# One direction in the four units that instruments offer, taken from a file in which all stand side by side.
def test_angles_of_all_units_are_one_direction() -> None:
    for data in ("2+0000000027746405", "3+0000000024971765", "4+0000000024943035", "5+0000000044394248"):
        assert word(f"21.32{data}").measure() == pytest.approx(math.radians(249 + 43 / 60 + 3.5 / 3600), abs=1e-6)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("31..00+--------", "word 31 has no value, its data are '--------'"),
        ("31..00+0003O485", "word 31 has no value"),
        ("81..00+    1234", "word 81 has no value"),
        ("31..02+00030485", "word 31 has the unit digit '2', expected one of 0, 1, 6, 7, 8 for a length"),
        ("21.32.+00030485", "word 21 has the unit digit '.', expected one of 2, 3, 4, 5 for an angle"),
        ("21.320+00030485", "word 21 has the unit digit '0'"),
        ("21.324+00160000", "60 minutes"),
        ("51..1.+00000017", "word 51 has no ppm and mm"),
    ],
)
def test_a_word_without_a_value_says_why(text: str, said: str) -> None:
    assert said in (word(text).fault() or "")


def test_word_51_is_split_at_its_second_sign() -> None:
    for text, constants in (
        ("51..1.+0000+000", (0, 0)),
        ("51....+0014-034", (14, -34)),
        ("51....-000000000017+034", (-17, 34)),
        ("51..1.+00000008+0000000", (8, 0)),
    ):
        assert word(text).constants() == constants, text


def test_texts_and_unknown_words_have_no_measure_and_no_fault() -> None:
    for text, kind in [
        ("71....+00000001", Kind.TEXT),
        ("42....+0000BP04", Kind.TEXT),
        ("95..10+0000?---", Kind.UNKNOWN),
    ]:
        assert word(text).kind is kind
        assert word(text).fault() is None
        with pytest.raises(WordError, match="neither an angle nor a length"):
            word(text).measure()


@pytest.mark.parametrize(
    ("data", "text"), [("0000A-LL", "A-LL"), ("00000000", "0"), ("00000070", "70"), ("0-----", "-----")]
)
def test_a_text_is_what_follows_the_zeros(data: str, text: str) -> None:
    assert GsiWord("11", "0001", "+", data).text == text


NAMES = st.text("ABCxyz123-_.", min_size=1, max_size=8)


@settings(max_examples=60)
@given(
    name=NAMES,
    wide=st.booleans(),
    unit=st.sampled_from(sorted(LENGTH_UNITS)),
    position=st.lists(st.floats(-300, 300), min_size=3, max_size=3),
)
def test_a_point_written_is_the_point_read(name: str, wide: bool, unit: str, position: list[float]) -> None:
    block = point_block(7, name, np.array(position), unit=unit, wide=wide)
    again = parse_line(format_block(block), 7)
    assert again == block
    assert again.words[0].text == name
    divisor, size = LENGTH_UNITS[unit]
    values = [word.measure() for word in again.words[1:]]
    np.testing.assert_allclose(values, position, atol=0.51 * size / divisor)


@settings(max_examples=60)
@given(angle=st.floats(0, 2 * math.pi), unit=st.sampled_from([*sorted(ANGLE_UNITS), "4"]))
def test_an_angle_written_is_the_angle_read(angle: float, unit: str) -> None:
    word = measured_word("21", angle, unit)
    step = math.pi / 180 / 36000 if unit == "4" else ANGLE_UNITS[unit][1] / ANGLE_UNITS[unit][0]
    assert word.measure() == pytest.approx(angle, abs=0.51 * step)


def test_seconds_round_up_to_the_next_minute_and_degree_and_nothing_is_written_as_minus_zero() -> None:
    assert measured_word("21", math.radians(12 - 1e-7), "4", wide=False).data == "01200000"
    assert measured_word("81", -1e-9, "6").sign == "+"


def test_names_that_would_not_be_read_back_and_values_that_do_not_fit_are_refused() -> None:
    for name in ("", "far too long", "007", " A", "A\n"):
        with pytest.raises(ValueError, match="expected a text of 1 to 8 characters"):
            text_word("11", name, wide=False)
    with pytest.raises(ValueError, match="does not fit 8 digits"):
        measured_word("81", 5250000.0, "8", wide=False)
    with pytest.raises(ValueError, match="cannot have the unit digit '2'"):
        measured_word("81", 1.0, "2")


@pytest.mark.parametrize("ending", ["\r\n", "\n", "\r"])
def test_a_file_written_is_the_file_read(tmp_path: Path, ending: str) -> None:
    blocks = [point_block(number, f"P{number}", np.full(3, number + 0.25), wide=number > 1) for number in (1, 2, 3)]
    path = tmp_path / "a.gsi"
    write_gsi(path, blocks, ending)
    assert read_gsi(path).blocks == tuple(blocks)
    assert path.read_bytes().count(ending.encode()) == 3
    assert sorted(read_gsi_points(path).points) == ["P1", "P2", "P3"]


def test_unknown_words_are_written_as_they_were() -> None:
    line = "110001+00000001 95.x1?-ab,d e;f 81..00+00000001 "
    block = parse_line(line)
    assert isinstance(block, GsiBlock)
    assert format_block(block) == line
