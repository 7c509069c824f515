import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.cameras import Equirectangular, StitchedEquirectangular, StitchedLens
from palletloc.geometry import FloatArray

TURNED = RigidTransform.from_rotation(Rotation.from_euler("z", 180, degrees=True))


def random_points(count: int) -> FloatArray:
    return np.asarray(np.random.default_rng(0).normal(size=(count, 3)))


def test_a_stitcher_that_was_right_leaves_the_panorama_as_it_is() -> None:
    camera = StitchedEquirectangular(800, 400, StitchedLens(RigidTransform.identity()), StitchedLens(TURNED))
    plain, points = Equirectangular(800, 400), random_points(3000)
    ours = camera.project(points)
    assert ours.valid.mean() > 0.999
    np.testing.assert_allclose(ours.pixels[ours.valid], plain.project(points).pixels[ours.valid], atol=1e-9)
    pixels = plain.project(points).pixels
    np.testing.assert_allclose(camera.unproject(pixels).directions, plain.unproject(pixels).directions, atol=1e-12)


def test_each_lens_sees_from_its_own_centre() -> None:
    front = RigidTransform.from_translation([0.02, 0.0, 0.0])
    back = RigidTransform.from_components([-0.02, 0.0, 0.0], TURNED.rotation)
    camera = StitchedEquirectangular(800, 400, StitchedLens(front), StitchedLens(back))
    points = random_points(2000)
    offset = np.where(points[:, :1] >= 0, [[0.02, 0, 0]], [[-0.02, 0, 0]])
    np.testing.assert_allclose(camera.centers(points), offset)
    ours = camera.project(points)
    expected = Equirectangular(800, 400).project(points - offset).pixels
    np.testing.assert_allclose(ours.pixels[ours.valid], expected[ours.valid], atol=1e-9)


def test_a_bend_moves_points_along_the_way_from_the_axis() -> None:
    lens = StitchedLens(RigidTransform.identity(), k1=0.01, k2=-0.002)
    camera = StitchedEquirectangular(3600, 1800, lens, StitchedLens(TURNED))
    for angle in np.radians([10.0, 45.0, 80.0]):
        column = camera.project(np.array([np.cos(angle), -np.sin(angle), 0.0])).pixels[0]
        placed = angle * (1 + 0.01 * angle**2 - 0.002 * angle**4)
        assert column == pytest.approx(1799.5 + 10 * np.degrees(placed))


def test_refuses_what_is_no_pair_of_lenses() -> None:
    front = StitchedLens(RigidTransform.identity())
    with pytest.raises(ValueError, match="must differ in their axis"):
        StitchedEquirectangular(200, 100, front, front)
    with pytest.raises(ValueError, match="the back lens folds"):
        StitchedEquirectangular(200, 100, front, StitchedLens(TURNED, k1=-0.3))
    with pytest.raises(ValueError, match="positive width"):
        StitchedEquirectangular(0, 100, front, StitchedLens(TURNED))
