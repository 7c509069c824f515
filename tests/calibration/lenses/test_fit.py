from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.intrinsics.corner_file import read_corners
from calibration.lenses.fit import Aperture, LensFit, bearing_sigma, fit_lenses, hold_out_rms
from calibration.lenses.linking import UnlinkedError
from calibration.lenses.models import MODELS, LensCamera, UnknownLensError, lens_model, model_of
from calibration.lenses.problem import BoardView
from palletloc.cameras import CameraModel, DoubleSphere, Equirectangular, Eucm, KannalaBrandt, Mei, Pinhole
from palletloc.geometry import FloatArray
from tests.calibration.board_room import grid, towards

OMNI = Path(__file__).resolve().parents[3].parent / "shared/data/real_lenses/omni_corners.xml"
SIZE = (1280, 960)
CAMERAS: dict[str, LensCamera] = {
    "kannala_brandt": KannalaBrandt(*SIZE, 300.0, 301.5, 650.0, 470.0, 0.02, -0.01, 0.003, -0.0005, 1.9),
    "mei": Mei(*SIZE, 560.0, 562.0, 650.0, 470.0, 1.1, -0.1, 0.03, 0.001, -0.002, 1.8),
    "double_sphere": DoubleSphere(*SIZE, 250.0, 251.0, 650.0, 470.0, -0.2, 0.56, 1.8),
    "eucm": Eucm(*SIZE, 300.0, 301.0, 650.0, 470.0, 0.58, 1.1, 1.8),
    "pinhole": Pinhole(*SIZE, 800.0, 803.0, 650.0, 470.0, -0.2, 0.05, 0.001, -0.0005, -0.01),
}


def photograph(
    camera: CameraModel, count: int = 20, *, noise: float = 0.1, reach_deg: float = 75.0, tilt_deg: float = 25.0,
    seed: int = 0,
) -> list[BoardView]:  # fmt: skip
    """Return corners of a board in random poses through a camera."""
    rng = np.random.default_rng(seed)
    views: list[BoardView] = []
    points = grid(9, 6, 0.06)
    while len(views) < count:
        pose = board_pose(rng, float(np.radians(reach_deg)), float(np.radians(tilt_deg)))
        pixels, valid = camera.project(pose.apply(points))
        if valid.mean() < 0.6:
            continue
        pixels = pixels[valid] + rng.normal(0, noise, (int(valid.sum()), 2))
        sigma = np.full(len(pixels), max(noise, 1e-3))
        views.append(BoardView(f"view {len(views)}", len(views), 0, 0, points[valid], pixels, sigma))
    return views


def board_pose(rng: np.random.Generator, reach: float, tilt: float) -> RigidTransform:
    """Return a board somewhere in the field, facing the lens but for a tilt."""
    angle, around = reach * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
    ray = np.array([np.cos(angle), np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around)])
    across = np.cross(ray, [0.0, 0.0, 1.0] if abs(ray[2]) < 0.9 else [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    facing = Rotation.from_matrix(np.stack([across, np.cross(ray, across), ray], axis=1))
    turn = Rotation.from_rotvec(rng.normal(0, tilt, 3) * [1, 1, 0.5])
    return RigidTransform.from_components(rng.uniform(0.5, 0.9) * ray, facing * turn)


def rays_of(camera: LensCamera) -> FloatArray:
    u, v = np.meshgrid(np.arange(3.0, camera.width, 41.0), np.arange(2.0, camera.height, 37.0))
    directions, _, valid = camera.unproject(np.stack([u, v], axis=-1).reshape(-1, 2))
    lengths = np.random.default_rng(0).uniform(0.2, 5.0, (len(directions), 1))
    return np.asarray((directions * lengths)[valid])


def fitted(views: Sequence[BoardView], name: str) -> LensFit:
    return fit_lenses(views, [MODELS[name]], [Aperture(np.array([639.5, 479.5]), 1280.0)])


def normalised_error(fit: LensFit, truth: FloatArray) -> float:
    error = fit.rig.values[0] - truth
    return float(error @ np.linalg.solve(fit.covariance, error))


@pytest.mark.parametrize("name", CAMERAS)
def test_exact_corners_give_the_lens_back(name: str) -> None:
    fit = fitted(photograph(CAMERAS[name], 15, noise=0.0), name)
    assert fit.rms() < 1e-4
    found, truth = fit.rig.values[0], MODELS[name].values(CAMERAS[name])
    np.testing.assert_allclose(found, truth, rtol=1e-3, atol=1e-3)


@pytest.mark.slow
# Not of mei: xi and the focal length make a curved valley, and only its bearings have honest sigmas.
@pytest.mark.parametrize("name", [name for name in CAMERAS if name != "mei"])
def test_the_covariance_is_honest_over_many_sets(name: str) -> None:
    model, camera = MODELS[name], CAMERAS[name]
    errors = [
        normalised_error(fitted(photograph(camera, 12, seed=seed), name), model.values(camera)) for seed in range(60)
    ]
    degrees = len(model.parameters)
    assert abs(np.mean(errors) - degrees) < 3.5 * np.sqrt(2 * degrees / 60)


def test_the_noise_is_found() -> None:
    views = [replace(view, sigma=np.full(len(view.points), 0.05)) for view in photograph(CAMERAS["eucm"], 15)]
    fit = fitted(views, "eucm")
    assert fit.sigma_factor == pytest.approx(2.0, rel=0.06)
    assert fit.rms() == pytest.approx(0.1 * np.sqrt(2), rel=0.06)


def test_wrong_corners_are_left_out() -> None:
    views = photograph(CAMERAS["kannala_brandt"], 12)
    rng = np.random.default_rng(0)
    spoilt = []
    for view in views:
        pixels = view.pixels.copy()
        pixels[rng.integers(len(pixels))] += 25.0
        spoilt.append(replace(view, pixels=pixels))
    fit = fitted(spoilt, "kannala_brandt")
    assert sum(int((~used).sum()) for used in fit.used) in range(12, 16)
    assert normalised_error(fit, MODELS["kannala_brandt"].values(CAMERAS["kannala_brandt"])) < 30
    assert fit.plain_rms > 3 * fit.rms()


def test_boards_all_alike_leave_bearings_open() -> None:
    camera = CAMERAS["pinhole"]
    facing = photograph(camera, 6, reach_deg=3.0, tilt_deg=0.01)
    tilted = photograph(camera, 6, reach_deg=30.0, tilt_deg=25.0)
    worst = []
    for views in (facing, tilted):
        try:
            fit = fitted(views, "pinhole")
        except np.linalg.LinAlgError:
            worst.append(np.inf)
            continue
        angles = np.radians(np.linspace(1.0, 25.0, 9))
        worst.append(float(bearing_sigma(MODELS["pinhole"], fit.rig.values[0], fit.covariance, angles).max()))
    assert worst[0] > 20 * worst[1]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["eucm", "mei"])
def test_bearings_are_as_sure_as_they_say(name: str) -> None:
    camera, model = CAMERAS[name], MODELS[name]
    angles = np.radians([20.0, 50.0, 70.0])
    around = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    angle, azimuth = (grid.ravel() for grid in np.meshgrid(angles, around, indexing="ij"))
    rays = np.stack([np.cos(angle), np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth)], axis=-1)
    pixels = camera.project(rays).pixels
    off, stated = [], []
    for seed in range(6):
        fit = fitted(photograph(camera, 10, seed=seed), name)
        found = model.camera(fit.rig.values[0], SIZE, 1.8).unproject(pixels).directions
        turn, _ = Rotation.align_vectors(rays, found)
        off.append(np.linalg.norm(turn.apply(found) - rays, axis=-1))
        stated.append(bearing_sigma(model, fit.rig.values[0], fit.covariance, angles).max())
    ratio = float(np.sqrt(np.mean(np.square(off)))) / float(np.mean(stated))
    assert 0.3 < ratio < 1.2  # the largest around the axis is stated


def test_views_left_out_are_as_good_as_the_others() -> None:
    fit = fitted(photograph(CAMERAS["eucm"], 16), "eucm")
    assert hold_out_rms(fit) == pytest.approx(fit.rms(), rel=0.15)
    few = fitted(photograph(CAMERAS["eucm"], 6), "eucm")
    assert np.isnan(hold_out_rms(few))


def two_lens_views(shots: int, *, shared: bool) -> tuple[list[BoardView], RigidTransform]:
    """Return boards that two lenses back to back see, some of them both at once, and the second lens's place."""
    lens = KannalaBrandt(1000, 1000, 280.0, 281.0, 499.0, 501.0, 0.01, -0.002, 0.0, 0.0, np.radians(105.0))
    back = RigidTransform.from_components([-0.03, 0.001, 0.002], Rotation.from_euler("zyx", [3.12, 0.01, -0.02]))
    points, rng, views = grid(8, 6, 0.05), np.random.default_rng(3), []
    for shot in range(shots):
        if shared and shot % 3 == 0:
            azimuth = rng.choice([-1, 1]) * np.pi / 2 + rng.normal(0, 0.05)
        else:
            azimuth = (np.pi if shot % 2 else 0.0) + rng.uniform(-0.9, 0.9)
        facing = towards(azimuth, rng.uniform(-0.6, 0.6))
        pose = RigidTransform.from_components(
            facing.apply([0.0, 0.0, rng.uniform(0.5, 0.8)]), facing * Rotation.from_rotvec(rng.normal(0, 0.35, 3))
        )
        for number, place in enumerate((RigidTransform.identity(), back)):
            pixels, valid = lens.project(place.inv().apply(pose.apply(points)))
            if valid.sum() > 20:
                seen = pixels[valid] + rng.normal(0, 0.05, (int(valid.sum()), 2))
                views.append(
                    BoardView(f"{shot} {number}", shot, 0, number, points[valid], seen, np.full(len(seen), 0.05))
                )
    return views, back


def test_two_lenses_find_their_places() -> None:
    views, back = two_lens_views(40, shared=True)
    apertures = [Aperture(np.array([499.5, 499.5]), 1000.0)] * 2
    fit = fit_lenses(views, [MODELS["kannala_brandt"]] * 2, apertures)
    off = fit.rig.lenses[1] * back.inv()
    error = np.concatenate([off.rotation.as_rotvec(), fit.rig.lenses[1].translation - back.translation])
    sigma = fit.sigma[fit.problem.columns()[1][1]]
    assert (np.abs(error) < 4 * sigma).all()
    assert sigma[3:].max() < 0.001
    assert np.abs(error[3:]).max() < 0.002


def test_lenses_that_never_see_one_board_have_no_places() -> None:
    views, _ = two_lens_views(20, shared=False)
    alone = [view for view in views if sum(other.shot == view.shot for other in views) == 1]
    with pytest.raises(UnlinkedError, match="no shot shows one board through both lenses"):
        fit_lenses(alone, [MODELS["kannala_brandt"]] * 2, [Aperture(np.array([499.5, 499.5]), 1000.0)] * 2)


def test_opencv_agrees_on_a_fisheye_below_90_degrees() -> None:
    camera = KannalaBrandt(*SIZE, 420.0, 421.0, 640.0, 480.0, 0.02, -0.01, 0.003, -0.0005, 1.4)
    views = photograph(camera, 12, reach_deg=45.0, seed=5)
    fit = fitted(views, "kannala_brandt")
    guess = np.array([[420.0, 0, 640.0], [0, 421.0, 480.0], [0, 0, 1.0]])
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | getattr(cv2, "CALIB_FIX_SKEW", 0)
    flags |= getattr(cv2, "CALIB_RECOMPUTE_EXTRINSIC", 0)
    rms, matrix, *_ = cv2.fisheye.calibrate(
        [view.points[None] for view in views], [view.pixels[None] for view in views], SIZE, guess, np.zeros((4, 1)),
        flags=flags,
    )  # fmt: skip
    assert fit.plain_rms == pytest.approx(rms, rel=0.01)
    np.testing.assert_allclose(fit.rig.values[0][:4], matrix[[0, 1, 0, 1], [0, 1, 2, 2]], atol=0.5)


@pytest.mark.skipif(not OMNI.is_file(), reason="the corners are not there")
@pytest.mark.parametrize(
    ("name", "rms"), [("mei", 0.8143), ("kannala_brandt", 1.94), ("double_sphere", 1.94), ("eucm", 1.94)]
)
def test_a_real_camera_beyond_90_degrees_has_the_residuals_that_others_state(name: str, rms: float) -> None:
    fit = fitted(read_corners(OMNI, SIZE, 1, fixed=False), name)
    assert fit.plain_rms == pytest.approx(rms, rel=0.02)
    assert fit.dropped == ()
    if name == "mei":
        # cv2.omnidir: the centre, and f and xi together as they act on the axis.
        np.testing.assert_allclose(fit.rig.values[0][2:4], [630.28, 431.92], atol=1.5)
        fx, xi = fit.rig.values[0][[0, 4]]
        assert fx / (1 + xi) == pytest.approx(408.90 / 2.05339, rel=0.005)


every_model = pytest.mark.parametrize("name", CAMERAS)


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
