import numpy as np

from calibration.check.pallet_heights import PalletElevations, height_estimate
from palletloc.geometry import FloatArray

CENTER = np.array([0.3, 0.1, 1.8])


def turned(vectors: FloatArray, turn: FloatArray) -> FloatArray:
    return vectors + np.cross(np.array([*turn, 0.0]), vectors)


def sights(rng: np.random.Generator, turn: FloatArray, higher: float, pallets: int = 4) -> PalletElevations:
    """Return pallets on both levels, as a camera sees them that is turned and higher than stated."""
    levels = np.array([0.0, 1.5])[np.arange(pallets) % 2]
    heights, off = levels + 0.006 * rng.standard_normal(pallets), 0.006 * rng.standard_normal(pallets)
    rows = []
    for way in np.linspace(0.0, 2.5, 10):
        for i in range(pallets):
            place = np.array([0.4 + 0.7 * i - way, 1.9, 0.0])
            ray = turned(np.array([*place[:2], heights[i] - CENTER[2] - higher]), turn)
            seen = float(np.arctan2(ray[2], np.hypot(*ray[:2]))) + 0.001 * rng.standard_normal()
            rows.append((i, np.arctan2(ray[1], ray[0]), float(np.hypot(*place[:2])) + off[i], seen, 0.001))
    pallet, azimuth, distance, elevation, sigma = np.array(rows).T
    return PalletElevations(pallet, azimuth, distance, elevation, sigma, levels, np.full(pallets, 0.006))


def test_pallets_tell_the_turn_and_the_height_within_what_they_state() -> None:
    square, pitch = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        truth = np.array([*np.radians(rng.uniform(-1, 1, 2)), 0.02 * rng.standard_normal()])
        estimate = height_estimate(sights(rng, truth[:2], truth[2]), CENTER[2])
        assert estimate is not None
        off = np.array([*estimate.tilt.turn, estimate.height]) - truth
        square.append(float(off @ np.linalg.solve(estimate.covariance, off)))
        pitch.append(float(np.degrees(np.sqrt(estimate.covariance[1, 1]))))
    assert 1.8 < np.mean(square) < 4.5  # three degrees of freedom
    assert max(pitch) < 0.1


def test_a_known_tilt_tells_the_height_better() -> None:
    truth = np.radians([0.4, -0.3])
    estimate = height_estimate(sights(np.random.default_rng(3), truth, 0.025), CENTER[2])
    assert estimate is not None
    height, sigma = estimate.height_given(truth, np.diag(np.radians([0.02, 0.02])) ** 2)
    assert sigma < np.sqrt(estimate.covariance[2, 2])
    assert abs(height - 0.025) < 3 * sigma


def test_a_pallet_of_unknown_height_still_tells_the_pitch_but_not_the_height() -> None:
    known = sights(np.random.default_rng(5), np.radians([0.0, 0.5]), 0.0)
    free = PalletElevations(
        known.pallet, known.azimuth, known.distance, known.elevation, known.sigma, known.heights, np.full(4, 0.3)
    )
    estimate = height_estimate(free, CENTER[2])
    assert estimate is not None
    sigma = np.sqrt(np.diag(estimate.covariance))
    assert abs(estimate.tilt.turn[1] - np.radians(0.5)) < 3 * sigma[1] < np.radians(0.5)
    assert sigma[2] > 0.015


def test_too_few_pallets_tell_nothing() -> None:
    alone = sights(np.random.default_rng(0), np.zeros(2), 0.0, pallets=1)
    few = PalletElevations(
        alone.pallet[:5], alone.azimuth[:5], alone.distance[:5], alone.elevation[:5], alone.sigma[:5], alone.heights,
        alone.height_sigmas,
    )  # fmt: skip
    assert height_estimate(few, CENTER[2]) is None
