from __future__ import annotations

import math

import pytest

from palletloc.survey.gsi import GsiWord, Kind, WordError, parse_line


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
@pytest.mark.parametrize(
    "text",
    [
        "21.322+0000000027746405",
        "21.323+0000000024971765",
        "21.324+0000000024943035",
        "21.325+0000000044394248",
    ],
)
def test_angles_of_all_units_are_one_direction(text: str) -> None:
    assert word(text).measure() == pytest.approx(math.radians(249 + 43 / 60 + 3.5 / 3600), abs=1e-6)


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


@pytest.mark.parametrize(
    ("text", "constants"),
    [
        ("51..1.+0000+000", (0, 0)),
        ("51....+0014-034", (14, -34)),
        ("51....-000000000017+034", (-17, 34)),
        ("51..1.+00000008+0000000", (8, 0)),
    ],
)
def test_word_51_is_split_at_its_second_sign(text: str, constants: tuple[int, int]) -> None:
    assert word(text).constants() == constants


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
