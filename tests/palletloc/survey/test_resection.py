import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

from palletloc.geometry import FloatArray, wrap_angle
from palletloc.survey.polar import PolarObservation, Station, reduce_sight
from palletloc.survey.resection import InstrumentSigma, ResectionError, resect

KNOWN = {
    "K1": np.array([105.0, 203.0, 11.0]),
    "K2": np.array([98.0, 209.0, 12.5]),
    "K3": np.array([94.0, 196.0, 10.4]),
    "K4": np.array([108.0, 194.0, 13.0]),
}
STATION = Station(np.array([100.0, 200.0, 10.0]), 2.2)
SIGMA = InstrumentSigma(angle=math.radians(5 / 3600), distance=1e-3)


def sight(name: str, point: FloatArray, line: int = 1) -> PolarObservation:
    """Return the exact sight of a point, with its heights."""
    east, north, high = point - STATION.position + np.array([0, 0, 0.3 - 1.5])
    reading = (math.atan2(east, north) - STATION.orientation) % (2 * math.pi)
    zenith = math.atan2(math.hypot(east, north), high)
    return PolarObservation(name, reading, zenith, math.hypot(east, north, high), 0.3, 1.5, line)


def sights() -> list[PolarObservation]:
    return [sight(name, point, line) for line, (name, point) in enumerate(KNOWN.items(), start=1)]


@pytest.mark.parametrize("count", [2, 3, 4])
def test_exact_sights_give_the_exact_station(count: int) -> None:
    found = resect(sights()[:count], KNOWN)
    assert_allclose(found.station.position, STATION.position, atol=1e-9)
    assert wrap_angle(found.station.orientation - STATION.orientation) == pytest.approx(0, abs=1e-10)
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
    assert_allclose(found.station.position, STATION.position, atol=1e-9)
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
        turn = wrap_angle(found.station.orientation - STATION.orientation)
        error = np.array([*(found.station.position - STATION.position), turn])
        total += float(error @ np.linalg.solve(found.covariance, error))
        residual += found.chi2
    for value, freedom in ((total, 4), (residual, found.freedom)):
        low, high = (float(chi2.ppf(level, freedom * count)) for level in (0.001, 0.999))
        assert low < value < high


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
