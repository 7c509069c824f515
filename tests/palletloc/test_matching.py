from __future__ import annotations

import cv2
import numpy as np
import pytest

from palletloc.geometry import FloatArray, Image
from palletloc.matching import FULL, Energy, channel_sum, component_gradients, edge_energy, gradient_across, smoothed

WINDOW = (41, 21)


def step(row: float, low: float = 60.0, high: float = 180.0, shape: tuple[int, int] = (80, 120)) -> Image:
    """An image that is bright above an edge along its rows."""
    cover = np.clip(row + 0.5 - np.arange(shape[0], dtype=np.float64), 0.0, 1.0)
    column = low + (high - low) * cover
    return np.repeat(np.round(column).astype(np.uint8)[:, None], shape[1], axis=1)


def patchwork(seed: int) -> Image:
    """An image of patches that differ in brightness, softened a little."""
    patches = np.random.default_rng(seed).uniform(20.0, 250.0, (8, 12))
    return np.asarray(cv2.GaussianBlur(np.kron(patches, np.ones((10, 10))), (0, 0), 1.0), dtype=np.uint8)


def centroid(profile: FloatArray | Energy) -> float:
    return float((np.arange(len(profile)) * profile).sum() / profile.sum())


def test_gradients_of_a_ramp_are_its_slopes() -> None:
    columns, rows = np.meshgrid(np.arange(40), np.arange(30))
    along_rows, along_columns = component_gradients((3 * columns + 2 * rows).astype(np.uint8))
    inside = np.s_[3:-3, 3:-3]
    np.testing.assert_allclose(along_rows[inside], 3.0, atol=0.51)  # the image holds whole gray levels
    np.testing.assert_allclose(along_columns[inside], 2.0, atol=0.51)


def test_the_strongest_channel_gives_the_gradient() -> None:
    weak, strong = step(40.0, 100, 120), step(40.0, 20, 200)
    for order in ((weak, strong, weak), (strong, weak, weak)):
        for whole, single in zip(component_gradients(np.dstack(order)), component_gradients(strong), strict=True):
            np.testing.assert_allclose(whole, single, atol=1e-3)


@pytest.mark.parametrize("row", [40.0, 40.25, 39.6])
def test_the_gradient_across_a_step_is_centred_on_it(row: float) -> None:
    gradient = gradient_across(step(row), True, 1.5, 2.0)
    assert centroid(gradient[20:60, 60]) + 20 == pytest.approx(row, abs=0.01)
    assert gradient[20:60, 60].sum() == pytest.approx(120.0, rel=0.01)  # what the edge changes in all


def test_there_is_no_gradient_across_an_edge_of_the_other_direction() -> None:
    assert gradient_across(step(40.0), False, 1.5, 2.0).max() < 1e-3
    np.testing.assert_allclose(
        gradient_across(step(40.0).T, False, 1.5, 2.0), gradient_across(step(40.0), True, 1.5, 2.0).T, atol=1e-3
    )


def test_an_edge_between_colours_of_one_brightness_is_seen() -> None:
    up, down = step(40.0, 60, 180), step(40.0, 180, 60)
    gradient = gradient_across(np.dstack([up, down, np.full_like(up, 90)]), True, 1.5, 2.0)
    single = gradient_across(up, True, 1.5, 2.0)
    np.testing.assert_allclose(gradient, np.sqrt(2.0) * single, rtol=1e-3, atol=1e-2)


def test_smoothing_along_an_edge_averages_what_varies_there() -> None:
    noise = np.random.default_rng(0).normal(0.0, 12.0, (80, 120))
    noisy = np.clip(step(40.0) + noise, 0, 255).astype(np.uint8)
    quiet = np.delete(gradient_across(noisy, True, 1.0, 8.0), np.s_[30:50], axis=0).mean()
    loud = np.delete(gradient_across(noisy, True, 1.0, 0.3), np.s_[30:50], axis=0).mean()
    assert quiet < 0.5 * loud


@pytest.mark.parametrize("dilation", [0, 1, 2])
def test_energy_lies_between_0_and_full_and_on_its_side_of_the_directions(dilation: int) -> None:
    level = edge_energy(step(40.0), WINDOW, dilation=dilation)
    upright = edge_energy(step(40.0).T, WINDOW[::-1], dilation=dilation)
    assert level.level.dtype == np.uint8
    assert 0.9 * FULL < level.level.max() <= FULL
    assert level.upright.max() == 0
    np.testing.assert_allclose(upright.upright, level.level.T, atol=1)
    assert upright.level.max() == 0


def test_dilation_widens_an_edge_across_and_not_along() -> None:
    part = np.full((80, 120), 60, np.uint8)
    part[:40, 40:80] = 180
    thin, wide = (edge_energy(part, WINDOW, dilation=d) for d in (0, 2))
    grown = (wide.level[:, 60] > 0.2 * FULL).sum() - (thin.level[:, 60] > 0.2 * FULL).sum()
    assert grown == 4
    np.testing.assert_array_equal(wide.level[39] > 0.2 * FULL, thin.level[37:44].max(axis=0) > 0.2 * FULL)


@pytest.mark.parametrize("gain", [0.5, 0.75])
def test_energy_hardly_depends_on_the_light(gain: float) -> None:
    image = patchwork(0)
    bright = edge_energy(image, WINDOW)
    dark = edge_energy((image * gain).astype(np.uint8), WINDOW)
    assert cv2.absdiff(bright.level, dark.level).mean() < 0.1 * bright.level.mean()
    assert cv2.absdiff(bright.upright, dark.upright).mean() < 0.1 * bright.upright.mean()


def test_a_weak_edge_counts_as_a_strong_one_where_it_is_the_only_one() -> None:
    weak, strong = edge_energy(step(40.0, 90, 110), WINDOW), edge_energy(step(40.0, 20, 230), WINDOW)
    assert weak.level.max() > 0.9 * strong.level.max()


def test_there_is_no_energy_in_a_plain_image_and_little_in_sensor_noise() -> None:
    plain = np.full((80, 120), 128, np.uint8)
    assert edge_energy(plain, WINDOW).level.max() == 0
    noisy = plain + np.random.default_rng(0).integers(0, 2, plain.shape, dtype=np.uint8)
    assert edge_energy(noisy, WINDOW, dilation=0).level.mean() < 0.15 * FULL


def test_smoothing_takes_noise_away_and_keeps_the_shape() -> None:
    clear = patchwork(1)
    noisy = np.clip(clear + np.random.default_rng(0).normal(0.0, 10.0, clear.shape), 0, 255).astype(np.uint8)
    smooth = smoothed(noisy, 0.004)
    assert smooth.shape == clear.shape
    assert smooth.dtype == np.uint8
    flat = np.s_[13:17, 13:17]  # the middle of a patch
    before, after = (np.abs(image[flat].astype(int) - clear[flat]).mean() for image in (noisy, smooth))
    assert after < 0.7 * before


def test_channels_add_up() -> None:
    channels = np.random.default_rng(0).uniform(0.0, 9.0, (6, 5, 3)).astype(np.float32)
    np.testing.assert_allclose(channel_sum(channels), channels.sum(axis=2), rtol=1e-6)
