import numpy as np
import pytest

from palletloc.synthetic.rig import Sensor, expose
from palletloc.synthetic.samples import Samples

PLAIN = Sensor(blur_px=0.0, noise=0.0, jpeg_quality=0)


def grey(light: float) -> Samples:
    return np.full((120, 160, 3), light, np.float32)


def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def test_a_plain_sensor_codes_light_as_screens_do() -> None:
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
    errors = [
        np.abs(expose(light, Sensor(0.0, noise=0.0, jpeg_quality=q), False, rng()) - exact).mean()
        for q in (95, 60, 20)
    ]
    assert 0 < errors[0] < errors[1] < errors[2]
