import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palletloc.survey.gsi import ANGLE_UNITS, LENGTH_UNITS, GsiBlock, parse_line, read_gsi
from palletloc.survey.gsi_points import read_gsi_points
from tests.palletloc.survey.gsi_writer import format_block, measured_word, point_block, text_word, write_gsi

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


def test_seconds_round_up_to_the_next_minute_and_degree() -> None:
    assert measured_word("21", math.radians(12 - 1e-7), "4", wide=False).data == "01200000"


def test_nothing_is_written_as_minus_zero() -> None:
    assert measured_word("81", -1e-9, "6").sign == "+"


@pytest.mark.parametrize("name", ["", "far too long", "007", " A", "A\n"])
def test_a_name_that_would_not_be_read_back_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="expected a text of 1 to 8 characters"):
        text_word("11", name, wide=False)


def test_a_value_that_does_not_fit_is_refused() -> None:
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
