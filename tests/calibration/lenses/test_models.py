import numpy as np
import pytest

from calibration.lenses.models import MODELS, LensCamera, UnknownLensError, lens_model, model_of
from palletloc.cameras import DoubleSphere, Equirectangular, Eucm, KannalaBrandt, Mei, Pinhole
from palletloc.geometry import FloatArray

CAMERAS: dict[str, LensCamera] = {
    "kannala_brandt": KannalaBrandt(900, 800, 210.0, 213.0, 451.0, 397.0, 0.03, -0.012, 0.002, -0.0002, 1.9),
    "mei": Mei(1280, 960, 409.0, 410.5, 630.3, 431.9, 1.053, -0.0083, 0.0118, 0.0228, -0.0042, 1.8),
    "double_sphere": DoubleSphere(752, 480, 210.0, 211.0, 365.8, 249.4, -0.24, 0.566, 1.8),
    "eucm": Eucm(752, 480, 210.0, 211.0, 365.8, 248.9, 0.586, 1.139, 1.8),
    "pinhole": Pinhole(800, 600, 520.0, 525.0, 405.0, 296.0, -0.28, 0.09, 0.002, -0.0015, -0.012),
}
every_model = pytest.mark.parametrize("name", CAMERAS)


def rays_of(camera: LensCamera) -> FloatArray:
    u, v = np.meshgrid(np.arange(3.0, camera.width, 41.0), np.arange(2.0, camera.height, 37.0))
    directions, _, valid = camera.unproject(np.stack([u, v], axis=-1).reshape(-1, 2))
    lengths = np.random.default_rng(0).uniform(0.2, 5.0, (len(directions), 1))
    return np.asarray((directions * lengths)[valid])


@every_model
def test_a_model_images_as_its_camera_does(name: str) -> None:
    camera, model = CAMERAS[name], MODELS[name]
    rays = rays_of(camera)
    assert len(rays) > 100
    np.testing.assert_allclose(
        model.evaluate(model.values(camera), rays).pixels, camera.project(rays).pixels, atol=1e-9
    )


@every_model
def test_parameters_survive_the_way_to_a_camera_and_back(name: str) -> None:
    camera, model = CAMERAS[name], MODELS[name]
    again = model.camera(model.values(camera), (camera.width, camera.height), getattr(camera, "max_angle", 1.0))
    assert again == camera
    assert model_of(camera) is model


@every_model
def test_derivatives_are_those_of_finite_differences(name: str) -> None:
    camera, model = CAMERAS[name], MODELS[name]
    values, rays = model.values(camera), rays_of(camera)[::3]
    imaged = model.evaluate(values, rays)
    for i in range(len(values)):
        step = 1e-6 * max(1.0, abs(values[i]))
        ends = [model.evaluate(values + sign * step * np.eye(len(values))[i], rays).pixels for sign in (1, -1)]
        np.testing.assert_allclose(imaged.by_values[:, :, i], (ends[0] - ends[1]) / (2 * step), rtol=1e-5, atol=1e-4)
    for i in range(3):
        ends = [model.evaluate(values, rays + sign * 1e-6 * np.eye(3)[i]).pixels for sign in (1, -1)]
        np.testing.assert_allclose(imaged.by_ray[:, :, i], (ends[0] - ends[1]) / 2e-6, rtol=1e-5, atol=1e-3)


def test_numbers_that_are_no_lens_are_not_admitted() -> None:
    model = MODELS["eucm"]
    good = model.values(CAMERAS["eucm"])
    assert model.admits(good)
    for place, value in ((0, -1.0), (4, 1.1), (5, 0.0), (2, np.nan)):
        bad = good.copy()
        bad[place] = value
        assert not model.admits(bad)


def test_an_unknown_model_is_named_with_the_nearest() -> None:
    with pytest.raises(UnknownLensError, match="'kanala_brandt'; did you mean 'kannala_brandt'"):
        lens_model("kanala_brandt")
    assert model_of(Equirectangular(200, 100)) is None
