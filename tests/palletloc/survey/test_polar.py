import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.stats import chi2

from palletloc.geometry import FloatArray, wrap_angle
from palletloc.survey.polar import (
    FaceErrors,
    PolarObservation,
    Station,
    average_faces,
    line_of_sight,
    misread_faces,
    reduce_sight,
)
from palletloc.survey.resection import InstrumentSigma, ResectionError, resect

HORIZONTAL = st.floats(0, 2 * math.pi, exclude_max=True)
ZENITH = st.floats(0.3, math.pi - 0.3)
ERROR = st.floats(-1e-4, 1e-4)
STATION = Station(np.array([500.0, 300.0, 20.0]), 0.4)


def turned_over(
    sight: PolarObservation, index: float = 0.0, collimation: float = 0.0
) -> tuple[PolarObservation, PolarObservation]:
    """Return both faces as an instrument with these errors reads them."""
    first = replace(sight, zenith=sight.zenith + index, horizontal=sight.horizontal + collimation)
    second = replace(
        sight,
        zenith=2 * math.pi - sight.zenith + index,
        horizontal=(sight.horizontal + math.pi - collimation) % (2 * math.pi),
        line=2,
    )
    return first, second


def test_the_axes_are_easting_northing_and_height() -> None:
    for horizontal, zenith, expected in [
        (0.0, math.pi / 2, [0, 1, 0]),
        (math.pi / 2, math.pi / 2, [1, 0, 0]),
        (1.0, 0.0, [0, 0, 1]),
    ]:
        sight = PolarObservation("P", horizontal, zenith, 1.0)
        assert_allclose(reduce_sight(sight, Station()), expected, atol=1e-15)


@given(HORIZONTAL, ZENITH)
def test_a_reduced_point_has_its_distance_and_heights(horizontal: float, zenith: float) -> None:
    sight = PolarObservation("P", horizontal, zenith, 7.5, reflector_height=1.3, instrument_height=1.6)
    aim = reduce_sight(sight, STATION) - STATION.position + np.array([0, 0, 1.3 - 1.6])
    assert np.linalg.norm(aim) == pytest.approx(7.5)
    assert line_of_sight(sight, STATION) @ aim == pytest.approx(7.5)


@given(HORIZONTAL, ZENITH)
def test_both_faces_lead_to_one_point(horizontal: float, zenith: float) -> None:
    first, second = turned_over(PolarObservation("P", horizontal, zenith, 5.0))
    assert (first.second_face, second.second_face) == (False, True)
    assert_allclose(reduce_sight(first, STATION), reduce_sight(second, STATION), atol=1e-9)


@settings(max_examples=60)
@given(HORIZONTAL, ZENITH, ERROR, ERROR)
def test_the_mean_of_two_faces_is_free_of_errors_and_these_are_told(
    horizontal: float, zenith: float, index: float, collimation: float
) -> None:
    true = PolarObservation("P", horizontal, zenith, 5.0, line=1)
    mean, (errors,) = average_faces(turned_over(true, index, collimation))
    assert_allclose(reduce_sight(mean, STATION), reduce_sight(true, STATION), atol=1e-9)
    assert errors.index == pytest.approx(index, abs=1e-12)
    assert errors.collimation == pytest.approx(collimation, abs=1e-12)
    assert errors.lines == (1, 2)


def test_faces_weigh_the_same_however_often_read_and_directions_on_both_sides_of_zero_are_averaged() -> None:
    true = PolarObservation("P", 6.28, 1.2, 5.0)
    first, second = turned_over(true, index=1e-4)
    mean, errors = average_faces([first, second, first, first])
    assert mean.zenith == pytest.approx(true.zenith, abs=1e-12)
    assert len(errors) == 1
    around = [PolarObservation("P", angle, 1.5, 5.0) for angle in (0.001, 2 * math.pi - 0.001)]
    mean, errors = average_faces(around)
    assert math.cos(mean.horizontal) == pytest.approx(1.0, abs=1e-12)
    assert errors == []


def test_a_pair_of_faces_unlike_the_others_is_misread() -> None:
    usual = [FaceErrors("P", (1, 2), 1e-4 + 1e-6 * number, -2e-4) for number in range(4)]
    assert misread_faces(usual) == []
    odd = [FaceErrors("Q", (8, 9), 2.1e-4, -2e-4), FaceErrors("R", (10, 11), 1e-4, -3.1e-4)]
    assert misread_faces([*usual, *odd]) == odd
    assert misread_faces([usual[0], odd[0]]) == []


def test_sights_of_different_targets_or_heights_are_not_averaged_and_one_without_distance_not_reduced() -> None:
    first = PolarObservation("P", 0.0, 1.5, 5.0)
    for other in (replace(first, name="Q"), replace(first, reflector_height=1.0)):
        with pytest.raises(ValueError, match="one target with equal heights"):
            average_faces([first, other])
    with pytest.raises(ValueError, match="expected a distance to 'P'"):
        reduce_sight(PolarObservation("P", 0.0, 1.5, None), Station())


KNOWN = {
    "K1": np.array([105.0, 203.0, 11.0]),
    "K2": np.array([98.0, 209.0, 12.5]),
    "K3": np.array([94.0, 196.0, 10.4]),
    "K4": np.array([108.0, 194.0, 13.0]),
}
SETUP = Station(np.array([100.0, 200.0, 10.0]), 2.2)
SIGMA = InstrumentSigma(angle=math.radians(5 / 3600), distance=1e-3)


def sight(name: str, point: FloatArray, line: int = 1) -> PolarObservation:
    """Return the exact sight of a point, with its heights."""
    east, north, high = point - SETUP.position + np.array([0, 0, 0.3 - 1.5])
    reading = (math.atan2(east, north) - SETUP.orientation) % (2 * math.pi)
    zenith = math.atan2(math.hypot(east, north), high)
    return PolarObservation(name, reading, zenith, math.hypot(east, north, high), 0.3, 1.5, line)


def sights() -> list[PolarObservation]:
    return [sight(name, point, line) for line, (name, point) in enumerate(KNOWN.items(), start=1)]


@pytest.mark.parametrize("count", [2, 3, 4])
def test_exact_sights_give_the_exact_station(count: int) -> None:
    found = resect(sights()[:count], KNOWN)
    assert_allclose(found.station.position, SETUP.position, atol=1e-9)
    assert wrap_angle(found.station.orientation - SETUP.orientation) == pytest.approx(0, abs=1e-10)
    assert found.freedom == 3 * count - 4
    assert found.chi2 == pytest.approx(0, abs=1e-9)


def test_sights_reduced_from_the_station_are_the_known_points() -> None:
    station = resect(sights(), KNOWN).station
    for sight in sights():
        assert_allclose(reduce_sight(sight, station), KNOWN[sight.name], atol=1e-9)


def test_the_second_face_and_a_sight_without_distance_help_as_well() -> None:
    first, second, third, fourth = sights()
    second = replace(second, horizontal=second.horizontal + math.pi, zenith=2 * math.pi - second.zenith)
    found = resect([first, second, third, replace(fourth, distance=None)], KNOWN)
    assert_allclose(found.station.position, SETUP.position, atol=1e-9)
    assert np.isnan(found.residuals[3, 2])
    assert found.freedom == 7


def test_the_covariance_and_the_residuals_are_true(rng: np.random.Generator) -> None:
    count, total, residual = 200, 0.0, 0.0
    for _ in range(count):
        noisy = [
            replace(
                sight,
                horizontal=sight.horizontal + rng.normal(0, SIGMA.angle / math.sin(sight.zenith)),
                zenith=sight.zenith + rng.normal(0, SIGMA.angle),
                distance=(far := sight.distance or 0.0) + rng.normal(0, SIGMA.distance + SIGMA.per_metre * far),
            )
            for sight in sights()
        ]
        found = resect(noisy, KNOWN, SIGMA)
        turn = wrap_angle(found.station.orientation - SETUP.orientation)
        error = np.array([*(found.station.position - SETUP.position), turn])
        total += float(error @ np.linalg.solve(found.covariance, error))
        residual += found.chi2
    for value, freedom in ((total, 4), (residual, found.freedom)):
        assert chi2.ppf(0.001, freedom * count) < value < chi2.ppf(0.999, freedom * count)


def test_what_does_not_fix_the_station_is_refused() -> None:
    first, second, third, _ = sights()
    above = {"K1": KNOWN["K1"], "K5": KNOWN["K1"] + np.array([0, 0, 2.0])}
    for some, known, said in [
        ([first], KNOWN, "it has 1 point, expected at least 2"),
        ([replace(first, distance=None), second], KNOWN, "it has 1 point"),
        ([first, sight("K5", above["K5"])], above, "stand above one another"),
        ([first, second], {**KNOWN, "K1": np.array([1e12, 0.0, 0.0])}, "no station fits|does not settle"),
        ([first, second, replace(third, name="K9", line=12)], KNOWN, "point 'K9' of line 12 is not among the known"),
    ]:
        with pytest.raises(ResectionError, match=said):
            resect(some, known)
