import numpy as np
import pytest

from palletloc.synthetic.texture import Texture, TexturePattern, noise_levels, sample, srgb


@pytest.mark.parametrize("pattern", list(TexturePattern))
def test_noise_has_zero_mean_and_unit_variance_and_closes_around(pattern: TexturePattern) -> None:
    tile = noise_levels(pattern, 3)[0]
    assert tile[:-1, :-1].mean() == pytest.approx(0.0, abs=1e-3)
    assert tile[:-1, :-1].std() == pytest.approx(1.0, abs=1e-3)
    assert (tile[0] == tile[-1]).all()
    assert (tile[:, 0] == tile[:, -1]).all()


@pytest.mark.parametrize("pattern", list(TexturePattern))
def test_equal_seeds_give_equal_noise(pattern: TexturePattern) -> None:
    noise_levels.cache_clear()
    first = noise_levels(pattern, 1)[0].copy()
    noise_levels.cache_clear()
    assert (noise_levels(pattern, 1)[0] == first).all()
    assert (noise_levels(pattern, 2)[0] != first).any()


def test_a_texture_repeats_after_its_period_and_fades_with_the_footprint() -> None:
    texture = Texture(TexturePattern.SPECKLE, 0.5, 0.1)
    u, v = np.random.default_rng(0).uniform(0, 3, (2, 5000)).astype(np.float32)
    fine = np.full(5000, 1e-4, np.float32)
    near = sample(texture, 0, u, v, fine)
    assert near.std() > 0.05
    assert sample(texture, 0, u + np.float32(0.5), v, fine) == pytest.approx(near, abs=0.02)
    deviations = [sample(texture, 0, u, v, fine * factor).std() for factor in (1, 40, 160, 1e4)]
    assert deviations == sorted(deviations, reverse=True)
    assert deviations[-1] == 0.0


def test_screen_grey_is_darker_in_linear_light() -> None:
    assert srgb(188, 188, 188) == pytest.approx((0.5, 0.5, 0.5), abs=0.01)
    assert srgb(0, 0, 0) == (0.0, 0.0, 0.0)
