import numpy as np

from calibration.check.tilt_sources import FLOOR, LEVELS, PALLETS, VERTICALS, NamedTilt, fused_tilt
from calibration.shelf.gravity_lines import Tilt


def tilt(roll: float, pitch: float, sigma: tuple[float, float]) -> Tilt:
    return Tilt(np.radians([roll, pitch]), np.diag(np.radians(sigma) ** -2.0), 20)


def test_of_three_sources_the_two_that_contradict_each_other_are_named() -> None:
    told = [
        NamedTilt(VERTICALS, tilt(0.0, 0.0, (0.03, 0.03))),
        NamedTilt(LEVELS, tilt(0.0, 0.1, (100.0, 0.15))),
        NamedTilt(PALLETS, tilt(0.1, 0.5, (0.2, 0.04))),
    ]
    fused = fused_tilt(told)
    assert fused.chance < 1e-3
    assert fused.worst is not None
    assert {fused.worst.first, fused.worst.second} == {VERTICALS, PALLETS}


def test_sources_that_agree_make_the_result_surer() -> None:
    told = [NamedTilt(VERTICALS, tilt(0.2, 0.1, (0.04, 0.04))), NamedTilt(FLOOR, tilt(0.25, 0.0, (0.1, 90.0)))]
    fused = fused_tilt(told)
    assert fused.chance > 0.3
    assert np.degrees(np.sqrt(fused.covariance[0, 0])) < 0.04
    assert 0.2 < np.degrees(fused.turn[0]) < 0.25


def test_sources_of_different_axes_cannot_contradict_each_other() -> None:
    told = [NamedTilt(LEVELS, tilt(0.0, 1.0, (90.0, 0.1))), NamedTilt(FLOOR, tilt(1.0, 0.0, (0.1, 90.0)))]
    assert fused_tilt(told).worst is None
