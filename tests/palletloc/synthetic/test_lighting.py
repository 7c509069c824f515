from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from palletloc import LevelPose, PalletModel
from palletloc.choices import Illumination
from palletloc.synthetic.lighting import light_field, light_of
from palletloc.synthetic.pallet_solid import PalletBody
from palletloc.synthetic.rig import Sensor, expose
from palletloc.synthetic.samples import Samples
from palletloc.synthetic.scene import Box, Material
from palletloc.synthetic.texture import Texture, TexturePattern, noise_levels, sample, srgb

GREY = Material((0.5, 0.5, 0.5))
Scenes = Callable[[list[Any]], Any]


def at(*points: tuple[float, float]) -> tuple[Any, Any]:
    x, y = np.array(points, np.float32).T
    return x, y


def test_open_floor_has_the_light_of_every_direction_and_a_box_darkens_it_less_with_distance(hall: Scenes) -> None:
    field = light_field(hall([Box(LevelPose(0.0, 0.0, 0.5, 0.2), (1.0, 1.0, 1.0), GREY)]))
    open_floor = light_field(hall([])).on_floor(*at((0.0, 0.0), (5.0, -3.0)))
    assert open_floor == pytest.approx(field.light.open_ground, rel=1e-5)
    near, nearer, far = field.on_floor(*at((0.75, 0.0), (0.6, 0.0), (4.0, 0.0)))
    assert nearer <= near < far
    assert far == pytest.approx(field.light.open_ground, rel=1e-3)


def test_the_shadow_of_a_slab_lies_where_its_edges_are_projected(hall: Scenes) -> None:
    scene = hall([Box(LevelPose(0.0, 0.0, 1.0, 0.0), (2.0, 2.0, 0.02), GREY)])
    x = np.linspace(-3.0, 3.0, 1201).astype(np.float32)
    floor = light_field(scene).on_floor(x, np.zeros_like(x))
    # light from (0.6, 0, 0.8) throws the edges at x = +-1, one metre up, to -1.75 and 0.25; from the other
    # side to -0.25 and 1.75; the two directions across reach all between -1 and 1
    full = scene.light.open_ground
    expected = full * (1 - 0.25 * (np.abs(x + 0.75) < 1) - 0.25 * (np.abs(x - 0.75) < 1) - 0.5 * (np.abs(x) < 1))
    assert np.mean(np.abs(floor - expected) > 0.02 * full) < 0.05


def test_the_inside_of_an_opening_is_darker_than_the_face(closed_below: PalletModel, hall: Scenes) -> None:
    field = light_field(hall([PalletBody(LevelPose(0.0, 0.0, 0.0, 0.0), closed_below, GREY)]))
    front = np.array([[0.0], [0.0], [0.07]], np.float32), np.array([[-1.0], [0.0], [0.0]], np.float32)
    inner = np.array([[0.4], [-0.264], [0.001]], np.float32), np.array([[0.0], [0.0], [1.0]], np.float32)
    assert field.irradiance(*inner)[0] < 0.5 * field.irradiance(*front)[0]


@pytest.mark.parametrize("kind", list(Illumination))
def test_every_kind_of_light_gives_open_ground_the_light_that_it_says(kind: Illumination) -> None:
    light = light_of(kind, np.random.default_rng(5))
    assert light.open_ground == pytest.approx(1.0)
    assert np.linalg.norm(light.directions, axis=1) == pytest.approx(1.0)
    assert all(z > 0 for _, _, z in light.directions)
    assert (light.colour[1] < 0.5) == (kind is Illumination.DIM)


@pytest.mark.parametrize("pattern", list(TexturePattern))
def test_noise_of_a_seed_is_the_same_has_zero_mean_and_unit_variance_and_closes_around(
    pattern: TexturePattern,
) -> None:
    noise_levels.cache_clear()
    tile = noise_levels(pattern, 3)[0].copy()
    noise_levels.cache_clear()
    assert (noise_levels(pattern, 3)[0] == tile).all()
    assert (noise_levels(pattern, 2)[0] != tile).any()
    assert tile[:-1, :-1].mean() == pytest.approx(0.0, abs=1e-3)
    assert tile[:-1, :-1].std() == pytest.approx(1.0, abs=1e-3)
    assert (tile[0] == tile[-1]).all()
    assert (tile[:, 0] == tile[:, -1]).all()


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


PLAIN = Sensor(blur_px=0.0, noise=0.0, jpeg_quality=0)


def grey(light: float) -> Samples:
    return np.full((120, 160, 3), light, np.float32)


def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def test_a_plain_sensor_codes_light_as_screens_do() -> None:
    assert srgb(188, 188, 188) == pytest.approx((0.5, 0.5, 0.5), abs=0.01)  # darker in linear light
    assert srgb(0, 0, 0) == (0.0, 0.0, 0.0)
    for light, level in ((0.0, 0), (0.2140, 127), (0.5, 188), (1.0, 255), (3.0, 255)):
        assert expose(grey(light), PLAIN, False, rng())[0, 0].tolist() == pytest.approx([level] * 3, abs=1)


def test_noise_has_the_stated_size_at_a_middle_grey() -> None:
    image = expose(grey(0.18), Sensor(blur_px=0.0, noise=4.0, jpeg_quality=0), False, rng())
    assert image.std() == pytest.approx(4.0, rel=0.05)


def test_gain_brightens_and_falloff_darkens_the_lower_edge() -> None:
    image = expose(grey(0.1), Sensor(0.0, 2.0, 0.0, 0.5, 0), False, rng())
    assert image[0, 0, 0] == expose(grey(0.2), PLAIN, False, rng())[0, 0, 0]
    assert image[-1, 0, 0] == expose(grey(0.1), PLAIN, False, rng())[0, 0, 0]


def test_blur_keeps_the_place_of_an_edge_and_its_width_is_the_stated_one() -> None:
    light = np.zeros((60, 80, 3), np.float32)
    light[:, 40:] = 1.0
    code = np.arange(256) / 255
    linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    row = linear[expose(light, Sensor(2.0, noise=0.0, jpeg_quality=0), False, rng())[30, :, 1]]
    weights, columns = np.diff(row), np.arange(79) + 0.5
    middle = (weights * columns).sum() / weights.sum()
    assert middle == pytest.approx(39.5, abs=0.02)
    assert np.sqrt((weights * (columns - middle) ** 2).sum()) == pytest.approx(2.0, abs=0.08)


def test_a_closed_image_is_blurred_across_its_seam() -> None:
    light = np.random.default_rng(1).uniform(0, 1, (40, 64, 3)).astype(np.float32)
    sensor = Sensor(1.5, noise=0.0, jpeg_quality=0)
    rolled = expose(np.roll(light, 32, axis=1), sensor, True, rng())
    assert (rolled == np.roll(expose(light, sensor, True, rng()), 32, axis=1)).all()


def test_compression_changes_the_image_the_more_the_lower_its_quality() -> None:
    light = np.random.default_rng(1).uniform(0, 1, (64, 64, 3)).astype(np.float32)
    exact = expose(light, PLAIN, False, rng()).astype(float)
    images = [expose(light, Sensor(0.0, noise=0.0, jpeg_quality=quality), False, rng()) for quality in (95, 60, 20)]
    fine, middle, coarse = (np.abs(image - exact).mean() for image in images)
    assert 0 < fine < middle < coarse
