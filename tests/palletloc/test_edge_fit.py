from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from scipy.stats import norm

from palletloc.edge_fit import EdgeFit, EdgePeaks, edge_peaks, fit_edges, join_peaks
from palletloc.geometry import FloatArray
from palletloc.matching import gradient_across
from palletloc.plane import PlaneGrid
from palletloc.robust import SIGMA_PER_MEDIAN, cauchy_weights, huber_weights, reweighted, robust_sigma, tukey_weights

PIXEL = 0.004
GRID = PlaneGrid.spanning(-0.6, 0.6, -0.1, 0.1, PIXEL)
REACH = 0.03
UP, DOWN = np.array([0.0, 1.0]), np.array([0.0, -1.0])
ENDS = (np.array([[-0.5, 0.0]]), np.array([[0.5, 0.0]]))


def step_image(offset: FloatArray | float, slope: float = 0.0, contrast: float = 80.0) -> FloatArray:
    """An edge ``offset + slope * right`` above the middle, drawn by the share of each pixel beyond it."""
    columns, rows = np.meshgrid(np.arange(GRID.columns), np.arange(GRID.rows))
    right, up = np.moveaxis(GRID.points(np.stack([columns, rows], -1).astype(np.float64)), -1, 0)
    return np.asarray(60.0 + contrast * np.clip((up - offset - slope * right) / PIXEL + 0.5, 0.0, 1.0))


def noisy(image: FloatArray, sigma: float, seed: int = 0) -> FloatArray:
    return image + np.random.default_rng(seed).normal(0.0, sigma, image.shape)


def peaks_of(image: FloatArray, across: FloatArray = UP, reach: float = REACH) -> EdgePeaks:
    gradient = gradient_across(np.clip(image, 0, 255).astype(np.uint8), True, 1.0, 1.0)
    return edge_peaks(gradient, GRID, *ENDS, across, np.array([reach]))


def fitted(peaks: EdgePeaks, slope_sigma: FloatArray | None = None) -> EdgeFit | None:
    size = np.full(len(peaks.along), PIXEL)
    fits = fit_edges(peaks, size, size, REACH, slope_sigma)
    assert len(fits) == len(peaks.along)
    return fits[0]


def line(image: FloatArray) -> EdgeFit:
    fit = fitted(peaks_of(image))
    assert fit is not None
    return fit


@pytest.mark.parametrize("offset_px", [-3.4, -0.5, -0.2, 0.0, 0.3, 0.49, 2.75])
@pytest.mark.parametrize("slope", [-0.02, 0.0, 0.013])
def test_a_drawn_edge_is_measured_to_a_small_part_of_a_pixel(offset_px: float, slope: float) -> None:
    fit = line(step_image(offset_px * PIXEL, slope))
    assert fit.offset == pytest.approx(offset_px * PIXEL, abs=0.04 * PIXEL)
    assert fit.slope == pytest.approx(slope, abs=0.05 * PIXEL)
    assert fit.coverage > 0.95


def test_offsets_count_in_the_direction_across_upright_or_level() -> None:
    image = step_image(1.3 * PIXEL, 0.01)
    up, down = (fitted(peaks_of(image, across)) for across in (UP, DOWN))
    assert up is not None
    assert down is not None
    assert down.offset == pytest.approx(-up.offset, abs=0.02 * PIXEL)
    assert down.slope == pytest.approx(-up.slope, abs=1e-4)
    grid = PlaneGrid.spanning(-0.1, 0.1, -0.6, 0.6, PIXEL)
    turned = np.ascontiguousarray(step_image(-0.7 * PIXEL, 0.01)[::-1, ::-1].T)  # right and up exchanged
    gradient = gradient_across(turned.astype(np.uint8), False, 1.0, 1.0)
    bottom, top = (end[:, ::-1] for end in ENDS)
    fit = fitted(edge_peaks(gradient, grid, bottom, top, UP[::-1], np.array([REACH])))
    assert fit is not None
    assert fit.offset == pytest.approx(-0.7 * PIXEL, abs=0.04 * PIXEL)
    assert fit.slope == pytest.approx(0.01, abs=2e-4)


def test_the_sigmas_tell_the_scatter_of_the_results_and_grow_with_noise() -> None:
    truth_offset, truth_slope, sigma = 0.3 * PIXEL, 0.004, 14.0
    image = step_image(truth_offset, truth_slope, contrast=50.0)
    fits = [line(noisy(image, sigma, seed)) for seed in range(60)]
    offsets = np.array([(fit.offset - truth_offset) / fit.sigma_offset for fit in fits])
    slopes = np.array([(fit.slope - truth_slope) / fit.sigma_slope for fit in fits])
    for normalised in (offsets, slopes):
        assert 0.3 < np.mean(normalised**2) < 3.0
    quiet, loud = (line(noisy(step_image(0.0), sigma)) for sigma in (4.0, 12.0))
    assert quiet.sigma_offset < loud.sigma_offset
    assert quiet.sigma_slope < loud.sigma_slope


def test_a_fifth_of_the_edge_elsewhere_does_not_move_the_line() -> None:
    right = GRID.points(np.stack([np.arange(GRID.columns), np.zeros(GRID.columns)], -1))[:, 0]
    offset = np.where(right > 0.3, 4.0, 0.25) * PIXEL
    fit = line(noisy(step_image(offset[None, :]), 3.0))
    assert fit.offset == pytest.approx(0.25 * PIXEL, abs=0.1 * PIXEL)
    assert abs(fit.slope) < 0.2 * PIXEL
    assert fit.coverage < 0.85


def test_coverage_is_the_part_that_is_seen_and_strength_the_gradient_of_the_strongest_edge() -> None:
    image = step_image(0.0)
    image[:, : GRID.columns // 2] = 100.0
    assert line(image).coverage == pytest.approx(0.5, abs=0.06)
    weak, strong = line(step_image(0.0, contrast=40.0)), line(step_image(0.0, contrast=120.0))
    assert strong.strength == pytest.approx(3 * weak.strength, rel=0.05)
    image = step_image(-0.02, contrast=30.0) + step_image(0.015, contrast=70.0) - 60.0
    assert line(image).offset == pytest.approx(0.015, abs=0.2 * PIXEL)


@pytest.mark.parametrize("sigma", [0.0, 5.0])
def test_there_is_no_line_where_there_is_no_edge(sigma: float) -> None:
    plain = np.full((GRID.rows, GRID.columns), 120.0)
    assert all(fitted(peaks_of(noisy(plain, sigma, seed))) is None for seed in range(10))


def test_each_edge_has_its_own_reach_and_a_slope_towards_one_beyond_is_no_peak() -> None:
    gradient = gradient_across(step_image(0.04).astype(np.uint8), True, 6.0, 1.0)
    near = edge_peaks(gradient, GRID, *ENDS, UP, np.array([0.02]))
    assert (near.strength == 0.0).all()
    assert fitted(near) is None
    far = edge_peaks(gradient, GRID, *ENDS, UP, np.array([0.05]))
    np.testing.assert_allclose(far.offset, 0.04, atol=0.5 * PIXEL)
    gradient = gradient_across(step_image(0.02).astype(np.uint8), True, 1.0, 1.0)
    starts, ends = (np.repeat(end, 2, axis=0) for end in ENDS)
    peaks = edge_peaks(gradient, GRID, starts, ends, UP, np.array([0.01, 0.03]))
    assert (peaks.strength[0] == 0.0).all()
    np.testing.assert_allclose(peaks.offset[1], 0.02, atol=0.1 * PIXEL)


def test_edges_measured_together_or_in_stretches_are_as_measured_alone() -> None:
    gradient = gradient_across(noisy(step_image(0.2 * PIXEL), 3.0).astype(np.uint8), True, 1.0, 1.0)
    starts, ends = np.array([[-0.5, 0.0], [-0.1, 0.004]]), np.array([[0.5, 0.0], [0.2, 0.004]])
    together = edge_peaks(gradient, GRID, starts, ends, UP, np.full(2, REACH))
    alone = edge_peaks(gradient, GRID, starts[:1], ends[:1], UP, np.full(1, REACH))
    np.testing.assert_array_equal(together.offset[0], alone.offset[0])
    fits = fit_edges(together, np.full(2, PIXEL), np.full(2, PIXEL), REACH)
    assert fits[0] == fitted(alone)
    assert fits[1] is not None
    assert fits[1].offset == pytest.approx(0.2 * PIXEL - 0.004, abs=0.15 * PIXEL)
    gradient = gradient_across(step_image(0.4 * PIXEL, 0.01).astype(np.uint8), True, 1.0, 1.0)
    starts = np.array([[-0.5, 0.0], [-0.1, 0.0], [0.3, 0.0]])
    ends = np.array([[-0.3, 0.0], [0.1, 0.0], [0.5, 0.0]])
    single = edge_peaks(gradient, GRID, starts, ends, UP, np.full(3, REACH))
    joined = join_peaks(single, (starts + ends)[:, 0] / 2, [range(3), range(1)])
    assert joined.along.shape[0] == 2
    whole, part = fit_edges(joined, np.full(2, PIXEL), np.full(2, PIXEL), REACH)
    assert whole is not None
    assert part is not None
    assert whole.offset == pytest.approx(0.4 * PIXEL, abs=0.05 * PIXEL)
    assert whole.slope == pytest.approx(0.01, abs=2e-4)
    assert whole.sigma_slope < part.sigma_slope
    assert whole.coverage == pytest.approx(part.coverage, abs=0.05)  # the gaps between stretches do not count


def test_noise_does_not_tilt_an_edge_whose_slope_is_known() -> None:
    gradient = gradient_across(noisy(step_image(0.0), 12.0).astype(np.uint8), True, 1.0, 1.0)
    starts, ends = np.array([[-0.06, 0.0]]), np.array([[0.06, 0.0]])
    peaks = edge_peaks(gradient, GRID, starts, ends, UP, np.array([0.02]))
    free, held = fitted(peaks), fitted(peaks, np.array([2e-4]))
    assert free is not None
    assert held is not None
    assert abs(free.slope) > 1e-3
    assert abs(held.slope) < 0.2 * abs(free.slope)
    assert held.sigma_slope <= 2e-4 < free.sigma_slope


# Robust fits: weights fall with residuals, and wrong values do not move a line.

WEIGHTS = [tukey_weights, huber_weights, cauchy_weights]
Weigh = Callable[..., FloatArray]


@pytest.mark.parametrize("weigh", WEIGHTS)
def test_weights_fall_from_one_to_zero_whatever_the_sign_and_the_scale(weigh: Weigh) -> None:
    residuals = np.linspace(0, 1e4, 10001)
    weights = weigh(residuals)
    assert weights[0] == 1
    assert (np.diff(weights) <= 0).all()
    assert (weights >= 0).all()
    assert weights[-1] < 1e-3
    np.testing.assert_array_equal(weigh(-residuals), weights)
    np.testing.assert_allclose(weigh(7 * residuals, 7.0), weights, rtol=1e-12)


@pytest.mark.parametrize(("weigh", "efficiency"), list(zip(WEIGHTS, (0.95, 0.96, 0.93), strict=True)))
def test_the_constants_have_the_efficiency_that_they_state(weigh: Weigh, efficiency: float) -> None:
    # Of an M-estimator with psi(x) = x w(x) on normal residuals: E[psi']^2 / E[psi^2].
    x = np.linspace(-12, 12, 240001)
    density = norm.pdf(x) * (x[1] - x[0])
    psi = x * weigh(x)
    slope = np.gradient(psi, x)
    assert (slope @ density) ** 2 / (psi**2 @ density) == pytest.approx(efficiency, abs=0.005)


def test_one_round_is_the_plain_fit_and_the_spread_of_normal_residuals_their_deviation() -> None:
    assert pytest.approx(1 / norm.ppf(0.75), abs=1e-4) == SIGMA_PER_MEDIAN
    assert robust_sigma(np.array([-1.0, 1.0, 1e9])) == SIGMA_PER_MEDIAN
    assert robust_sigma(np.zeros(3), 0.5) == 0.5
    values = np.array([0.0, 0.0, 9.0])
    mean = reweighted(
        lambda weights, _: np.array([np.average(values, weights=weights)]),
        lambda at: values - at,
        partial(huber_weights, tuning=1.0),
        lambda _: 1.0,
        np.ones(3),
        1,
    )
    assert mean.solution[0] == 3.0
    np.testing.assert_allclose(mean.weights, [1 / 3, 1 / 3, 1 / 6])


@pytest.mark.parametrize("weigh", WEIGHTS)
def test_a_third_of_wrong_values_does_not_move_a_line(weigh: Weigh) -> None:
    rng = np.random.default_rng(0)
    design = np.stack([rng.uniform(-1, 1, 300), np.ones(300)], axis=1)
    values = design @ [2.0, 3.0] + rng.normal(0, 0.01, 300)
    values[:100] += rng.choice([-1.0, 1.0], 100) * rng.uniform(0.5, 1.0, 100)

    def fit(weights: FloatArray, _: float) -> FloatArray:
        return np.asarray(np.linalg.solve((design * weights[:, None]).T @ design, design.T @ (weights * values)))

    found = reweighted(fit, lambda line: values - design @ line, weigh, robust_sigma, np.ones(300), 20)
    np.testing.assert_allclose(found.solution, [2.0, 3.0], atol=0.01)
    assert found.weights[:100].max() < 0.1 < found.weights[100:].min() or weigh is not tukey_weights
    # Once the weights have settled, more rounds change nothing.
    early = reweighted(fit, lambda line: values - design @ line, weigh, robust_sigma, np.ones(300), 200, 1e-6)
    np.testing.assert_allclose(early.solution, found.solution, atol=1e-4)
