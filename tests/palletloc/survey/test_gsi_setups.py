"""Stations that change in a GSI file, with and without coordinates; every file is made from places that are known."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palletloc.geometry import FloatArray
from palletloc.survey.gsi import GsiBlock, GsiWord, parse_gsi
from palletloc.survey.gsi_points import points_of, read_gsi_points
from palletloc.survey.point import Survey, SurveyError
from palletloc.survey.polar import Station
from palletloc.survey.truth import read_surveyed_truth
from tests.palletloc.survey.gsi_writer import format_block, measured_word, text_word

KNOWN = {"K1": np.array([0.0, 10.0, 1.0]), "K2": np.array([10.0, 8.0, 1.2]), "K3": np.array([-4.0, 6.0, 0.7])}
SEEN = {"V1": np.array([2.0, 3.0, 0.5]), "A1": np.array([5.0, 6.0, 1.5])}
FIRST, SECOND = Station(np.array([1.0, 1.0, 0.3]), 0.4), Station(np.array([6.0, -2.0, 0.9]), 2.5)


def sight(name: str, point: FloatArray, station: Station, *words: GsiWord) -> str:
    """Return the line of a sight, exact to the last digit."""
    east, north, high = point - station.position
    horizontal = (math.atan2(east, north) - station.orientation) % (2 * math.pi)
    measured = (
        measured_word("21", horizontal, "2"),
        measured_word("22", math.atan2(math.hypot(east, north), high), "2"),
        measured_word("31", math.hypot(east, north, high), "8"),
    )
    return format_block(GsiBlock(1, True, (text_word("11", name), *words, *measured)))


def sights(names: Sequence[str], station: Station) -> list[str]:
    return [sight(name, {**KNOWN, **SEEN}[name], station) for name in names]


def header(name: str) -> str:
    """Return a line with a station's name and its instrument's height, without coordinates."""
    words = text_word("11", name), text_word("16", name), measured_word("88", 0.0, "6")
    return format_block(GsiBlock(1, True, words))


def code(number: str, *information: str) -> str:
    """Return a code block."""
    words = (text_word(str(42 + index), text) for index, text in enumerate(information))
    return format_block(GsiBlock(1, True, (text_word("41", number), *words)))


def survey(*lines: str, known: dict[str, FloatArray] | None = None) -> Survey:
    return points_of(parse_gsi(Path("a.gsi"), "\n".join(lines)), None, known)


BEGINS = pytest.mark.parametrize(
    "begin",
    [
        header,
        lambda name: header(name).replace("16....", "19....", 1),
        lambda name: code("21", name, "1.550"),
        lambda name: code("2", name, "1600"),
        lambda name: code("77", name),
    ],
    ids=["name and height", "height alone", "code 21", "code 2", "a station's name"],
)


@BEGINS
def test_each_station_is_found_from_its_own_known_points(begin: object) -> None:
    assert callable(begin)
    lines = [begin("ST01"), *sights(["K1", "K2", "K3", "V1"], FIRST)]
    lines += [begin("ST02"), *sights(["K1", "K2", "K3", "A1"], SECOND)]
    found = survey(*lines, known=KNOWN)
    for name, place in {**KNOWN, **SEEN}.items():
        assert_allclose(found.require(name).position, place, atol=2e-4, err_msg=name)
    assert list(found.remarks()) == []


@BEGINS
def test_a_station_without_coordinates_and_known_points_is_refused_by_its_name(begin: object) -> None:
    assert callable(begin)
    found = survey(begin("ST01"), *sights(["K1", "V1"], FIRST), begin("ST02"), *sights(["K1", "A1"], SECOND))
    assert found.require("V1").lines == (3,)
    with pytest.raises(SurveyError, match=r"a\.gsi, line 4: station 'ST02' has no coordinates .* state known points"):
        found.require("A1")
    assert_allclose(
        np.linalg.norm(found.require("K1").position), np.linalg.norm(KNOWN["K1"] - FIRST.position), rtol=1e-4
    )


def test_the_name_of_the_station_in_measured_lines_changes_it_too() -> None:
    lines = [sight(name, SEEN[name], FIRST, text_word("16", "ST01")) for name in SEEN]
    lines += [sight("B1", SEEN["A1"], SECOND, text_word("16", "ST02"))]
    found = survey(*lines)
    assert set(found.points) == set(SEEN)
    with pytest.raises(SurveyError, match=r"line 3: station 'ST02' has no coordinates"):
        found.require("B1")


def test_points_that_both_stations_sighted_tie_them_together() -> None:
    found = survey(
        header("ST01"), *sights(["K1", "K2", "V1"], FIRST), header("ST02"), *sights(["K1", "K2", "K3", "A1"], SECOND)
    )
    names = ["K1", "K2", "K3", "V1", "A1"]
    places = np.array([found.require(name).position for name in names])
    true = np.array([{**KNOWN, **SEEN}[name] for name in names])
    distances = [np.linalg.norm(points[:, None] - points[None], axis=2) for points in (places, true)]
    assert_allclose(distances[0], distances[1], atol=3e-4)


def test_a_station_with_coordinates_keeps_them_when_its_header_follows() -> None:
    straight = Station(FIRST.position, 0.0)
    mark = [measured_word(index, value, "8") for index, value in zip(("84", "85", "86"), FIRST.position, strict=True)]
    given = format_block(GsiBlock(1, True, (text_word("11", "ST01"), *mark)))
    found = survey(given, header("ST01"), *sights(["V1", "A1"], straight))
    for name, place in SEEN.items():
        assert_allclose(found.require(name).position, place, atol=2e-4)
    found = survey(given, *sights(["V1"], straight), header("ST02"), *sights(["A1"], SECOND))
    assert_allclose(found.require("V1").position, SEEN["V1"], atol=2e-4)
    with pytest.raises(SurveyError, match="station 'ST02' has no coordinates"):
        found.require("A1")


def test_a_code_that_is_no_station_changes_nothing() -> None:
    found = survey(*sights(["V1"], FIRST), code("41", "TREES", "4.5"), *sights(["A1"], FIRST))
    apart = np.linalg.norm(found.require("V1").position - found.require("A1").position)
    assert_allclose(apart, np.linalg.norm(SEEN["V1"] - SEEN["A1"]), atol=2e-4)


def test_known_points_that_do_not_fit_are_refused_with_figures() -> None:
    moved = {**KNOWN, "K2": KNOWN["K2"] + np.array([2.0, 1.0, 0.0])}
    found = survey(header("ST01"), *sights(["K1", "K2", "K3", "V1"], FIRST), known=moved)
    said = (
        r"line 1: station 'ST01' does not fit its known points, which its sights miss by 'K1' \d\.\d{3} m, 'K2' \d\."
    )
    with pytest.raises(SurveyError, match=said):
        found.require("V1")
    found = survey(*sights(["K1", "K2", "V1"], FIRST), known={"K1": moved["K1"], "K2": moved["K2"]})
    with pytest.raises(SurveyError, match=r"line 1: the station does not fit its known points"):
        found.require("V1")


def test_of_many_known_points_a_wrong_one_is_left_out() -> None:
    more = {**KNOWN, "A1": SEEN["A1"], "K3": KNOWN["K3"] + 1.0}
    found = survey(header("ST01"), *sights(["K1", "K2", "K3", "A1", "V1"], FIRST), known=more)
    assert_allclose(found.require("V1").position, SEEN["V1"], atol=2e-4)
    assert any("point 'K3': angles and distance lead 1732" in remark for remark in found.remarks())


def test_the_faults_that_were_found_are_right_now(shared_data: Path) -> None:
    faults = shared_data / "faults"
    (pose,) = read_surveyed_truth(faults / "gsi-free-stations").stops[0].poses
    there = pose.forklift_from_pallet
    assert_allclose((there.x, there.y, there.yaw), (3.0848, 0.6955, 0.2), atol=3e-4)
    with pytest.raises(SurveyError, match=r"survey\.gsi, line 5: station 'ST02' has no coordinates"):
        read_surveyed_truth(faults / "gsi-two-stations-one-frame")
    known = {"K1": np.array([0.0, 10.0, 0.0]), "K2": np.array([10.0, 0.0, 0.0])}
    for given in (known, None):
        found = read_gsi_points(faults / "gsi-free-stations" / "b.gsi", known=given)
        assert_allclose(found.require("K1").position, known["K1"], atol=1e-3)
        # 5 m from (10, 10), half-way to the first station: by arithmetic.
        assert_allclose(found.require("V2").position, [10 - 12.5**0.5, 10 - 12.5**0.5, 0], atol=1e-3)
    wrong = {**known, "K2": np.array([13.0, 0.0, 0.0])}
    with pytest.raises(SurveyError, match=r"station 'ST01' does not fit its known points"):
        read_gsi_points(faults / "gsi-free-stations" / "b.gsi", known=wrong).require("V1")
