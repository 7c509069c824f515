import math
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palletloc.geometry import FloatArray
from palletloc.survey.gsi import GsiBlock, GsiWord, parse_gsi
from palletloc.survey.gsi_points import points_of, read_gsi_points
from palletloc.survey.point import Survey, SurveyError
from palletloc.survey.polar import Station
from palletloc.survey.prism import PrismConstant, PrismConvention, PrismUse
from tests.palletloc.survey.gsi_writer import format_block, measured_word, text_word

STATION = Station(np.array([500.0, 300.0, 20.0]), 0.0)
TARGETS = {
    "P1": np.array([504.0, 303.0, 20.5]),
    "P2": np.array([498.0, 306.0, 21.5]),
    "P3": np.array([495.0, 296.0, 19.9]),
}
HI, HR = 1.6, 0.2


def polar_words(point: FloatArray, station: Station, *, second: bool = False, extra: float = 0.0) -> list[GsiWord]:
    """Return the exact words 21, 22, 31 and 87 of a point, its distance `extra` too long."""
    east, north, high = point - station.position + np.array([0, 0, HR - HI])
    horizontal = math.atan2(east, north) - station.orientation + (math.pi if second else 0.0)
    zenith = math.atan2(math.hypot(east, north), high)
    return [
        measured_word("21", horizontal % (2 * math.pi), "2"),
        measured_word("22", 2 * math.pi - zenith if second else zenith, "2"),
        measured_word("31", math.hypot(east, north, high) + extra, "8"),
        measured_word("87", HR, "6"),
    ]


def coordinate_words(point: FloatArray, indices: str = "81 82 83") -> list[GsiWord]:
    return [measured_word(index, value, "8") for index, value in zip(indices.split(), point, strict=True)]


def line(name: str, *words: GsiWord) -> str:
    return format_block(GsiBlock(1, True, (text_word("11", name), *words)))


def station_line(station: Station = STATION, name: str = "ST") -> str:
    return line(name, *coordinate_words(station.position, "84 85 86"), measured_word("88", HI, "6"))


def survey(*lines: str, prism: PrismUse | None = None, known: dict[str, FloatArray] | None = None) -> Survey:
    return points_of(parse_gsi(Path("a.gsi"), "\n".join(lines)), prism, known)


def assert_targets(found: Survey, atol: float = 2e-5) -> None:
    for name, place in TARGETS.items():
        assert_allclose(found.require(name).position, place, atol=atol)


def test_coordinates_are_taken_as_they_stand() -> None:
    found = survey(*(line(name, *coordinate_words(point)) for name, point in TARGETS.items()))
    assert_targets(found)
    assert found.require("P2").lines == (2,)
    assert list(found.remarks()) == []


def test_polar_words_are_reduced_from_the_station_before_them() -> None:
    lines = [line(name, *polar_words(point, STATION)) for name, point in TARGETS.items()]
    found = survey(station_line(), *lines)
    assert_targets(found)
    sight = found.require("P1").sight
    assert sight is not None
    assert np.linalg.norm(sight) == pytest.approx(1)
    other = Station(np.array([510.0, 290.0, 21.0]), 0.0)
    found = survey(
        station_line(),
        line("P1", *polar_words(TARGETS["P1"], STATION)),
        station_line(other),
        line("P2", *polar_words(TARGETS["P2"], other)),
        line("P3", *polar_words(TARGETS["P3"], other)),
    )
    assert_targets(found)


def test_without_a_station_points_lie_in_a_frame_of_their_own() -> None:
    found = survey(*(line(name, *polar_words(point, STATION)) for name, point in TARGETS.items()))
    shifts = [found.require(name).position - place for name, place in TARGETS.items()]
    assert_allclose(np.ptp(shifts, axis=0), 0, atol=2e-5)


def test_polar_lines_among_coordinates_take_the_station_that_these_imply() -> None:
    turned = Station(STATION.position, 1.0)
    lines = [
        line(name, *polar_words(TARGETS[name], turned), *coordinate_words(TARGETS[name])) for name in ("P1", "P2")
    ]
    assert_targets(survey(*lines, line("P3", *polar_words(TARGETS["P3"], turned))), atol=1e-4)
    found = survey(lines[0], line("P3", *polar_words(TARGETS["P3"], turned)))
    assert [(note.line, "tells no station" in note.text) for note in found.notes] == [(2, True)]
    assert found.find("P3") is None


def test_a_free_station_is_found_from_known_points() -> None:
    turned = Station(np.zeros(3), 0.0)
    moved = {name: point - STATION.position for name, point in TARGETS.items()}
    lines = [line(name, *polar_words(point, turned)) for name, point in moved.items()]
    found = survey(station_line(turned), *lines, known={name: TARGETS[name] for name in ("P1", "P2")})
    assert_targets(found, atol=1e-4)
    wrong = {"P1": TARGETS["P1"], "P2": TARGETS["P2"] + np.array([0.05, 0.05, 0.0])}
    notes = survey(station_line(turned), *lines, known=wrong).notes
    assert "mm away from its known place" in notes[0].text


def test_two_faces_are_averaged_and_their_errors_told() -> None:
    lines = []
    for name, point in TARGETS.items():
        words = polar_words(point, STATION), polar_words(point, STATION, second=True)
        for face in words:
            # An index error of 30 seconds spoils either face alone by 0.6 mm at 5 m.
            face[1] = measured_word("22", face[1].measure() + math.radians(30 / 3600), "2")
            lines.append(line(name, *face))
    found = survey(station_line(), *lines)
    assert_targets(found)
    assert [errors.lines for errors in found.faces] == [(2, 3), (4, 5), (6, 7)]
    assert_allclose([errors.index for errors in found.faces], math.radians(30 / 3600), atol=4e-7)
    assert_allclose([errors.collimation for errors in found.faces], 0, atol=4e-7)


def test_repeated_lines_are_averaged_but_one_name_at_two_places_is_unusable_and_both_are_named() -> None:
    shift = np.array([0.002, 0.0, 0.0])
    found = survey(*(line("P1", *coordinate_words(TARGETS["P1"] + side * shift)) for side in (-1, 1)))
    assert_allclose(found.require("P1").position, TARGETS["P1"], atol=1e-5)
    found = survey(line("P1", *coordinate_words(TARGETS["P1"])), line("P1", *coordinate_words(TARGETS["P2"])))
    with pytest.raises(SurveyError, match=r"a\.gsi, lines 1 and 2: point 'P1' has places 6\.7.. m apart"):
        found.require("P1")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (polar_words(TARGETS["P1"], STATION)[:2], "has neither coordinates"),
        (coordinate_words(TARGETS["P1"])[:2], "has neither coordinates"),
        ([*polar_words(TARGETS["P1"], STATION)[:3], GsiWord("87", "...0", "+", "-" * 16)], "word 87 without a value"),
    ],
)
def test_a_line_without_a_place_is_noted_and_gives_no_point(words: list[GsiWord], said: str) -> None:
    found = survey(station_line(), line("P1", *words))
    assert any(said in note.text and note.line == 2 for note in found.notes)
    assert found.find("P1") is None


def test_a_number_is_found_with_and_without_the_zeros_before_it() -> None:
    found = survey(line("7", *coordinate_words(TARGETS["P1"])))
    assert found.require("007") is found.require("7")
    with pytest.raises(SurveyError, match=r"a\.gsi: no point '8'; known are 7"):
        found.require("8")


LEICA_ZERO, ABSOLUTE_ZERO = PrismConstant(0.0), PrismConstant(0.0, PrismConvention.ABSOLUTE)


@pytest.mark.parametrize(
    ("words", "use", "extra"),
    [
        # The instrument was set to a round prism, but tape stood on the points: distances are 34.4 mm short.
        ([], PrismUse(ABSOLUTE_ZERO), -0.0344),
        ([], PrismUse(PrismConstant(0.0344)), -0.0344),
        ([GsiWord("51", "....", "+", "000000000000+034")], PrismUse(PrismConstant(0.034)), 0.0),
        ([GsiWord("51", "....", "+", "000000000000+034")], PrismUse(LEICA_ZERO), 0.034),
        ([measured_word("58", 0.0175, "6")], PrismUse(LEICA_ZERO), 0.0175),
        ([measured_word("58", -0.0344, "6")], PrismUse(LEICA_ZERO, words=PrismConvention.ABSOLUTE), 0.0),
        ([measured_word("58", 0.0175, "6")], PrismUse(LEICA_ZERO, setting=LEICA_ZERO), 0.0),
    ],
)
def test_a_stated_prism_corrects_what_the_instrument_was_set_to(
    words: list[GsiWord], use: PrismUse, extra: float
) -> None:
    polar = [line(name, *polar_words(point, STATION, extra=extra), *words) for name, point in TARGETS.items()]
    assert_targets(survey(station_line(), *polar, prism=use))


def test_a_stated_prism_corrects_coordinates_along_the_line_of_sight() -> None:
    lines = []
    for name, point in TARGETS.items():
        toward = point - STATION.position + np.array([0, 0, HR - HI])
        short = point - 0.0344 * toward / np.linalg.norm(toward)
        lines.append(line(name, *polar_words(point, STATION, extra=-0.0344), *coordinate_words(short)))
    assert_targets(survey(station_line(), *lines, prism=PrismUse(ABSOLUTE_ZERO)))
    bare = survey(line("P1", *coordinate_words(TARGETS["P1"])), prism=PrismUse(ABSOLUTE_ZERO))
    assert "prism constant not corrected" in bare.notes[0].text


def test_coordinates_that_disagree_with_their_own_angles_are_noted() -> None:
    lines = [line(name, *polar_words(point, STATION), *coordinate_words(point)) for name, point in TARGETS.items()]
    assert survey(station_line(), *lines).notes == ()
    # Without a station of its own, the setup's station is implied by these lines.
    bent = line("P4", *polar_words(TARGETS["P1"], STATION), *coordinate_words(TARGETS["P1"] + np.array([0.2, 0, 0])))
    (note,) = survey(*lines, bent).notes
    assert note.line == 4
    assert note.text == "point 'P4': angles and distance lead 200.0 mm away from its coordinates"


def test_faces_of_a_real_instrument_agree_within_seconds_and_a_misread_one_is_noted(shared_data: Path) -> None:
    found = read_gsi_points(shared_data / "gsi" / "two_faces.gsi")
    assert len(found.faces) > 60
    errors = np.degrees([[pair.index, pair.collimation] for pair in found.faces]) * 3600
    assert np.median(np.abs(errors)) < 2
    assert (np.abs(errors).max(axis=1) > 10).sum() == 1
    (misread,) = (note for note in found.notes if "misread" in note.text)
    assert misread.line == 121
    assert "index error -39.9" in misread.text
    assert "with line 122" in misread.text


def test_no_line_of_the_real_files_vanishes(shared_data: Path) -> None:
    for path in sorted((shared_data / "gsi").glob("*.gsi")):
        found = read_gsi_points(path)
        used = {number for point in found.points.values() for number in point.lines}
        used |= {note.line for note in (*found.rejected, *found.notes)}
        text = " ".join(found.unusable.values())
        for number, content in enumerate(path.read_text().splitlines(), start=1):
            is_point = content.lstrip("*").startswith("11") and "84.." not in content
            name = content.lstrip("*")[7:].split()[0].lstrip("0")
            assert not is_point or number in used or f"point '{name}'" in text, (path.name, number)
