import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.cameras import (
    CameraModel,
    DoubleSphere,
    DualFisheye,
    Equirectangular,
    Eucm,
    FisheyeLens,
    KannalaBrandt,
    Mei,
    Pinhole,
    RationalPinhole,
    StitchedEquirectangular,
    StitchedLens,
)
from palletloc.geometry import FloatArray
from tests.palletloc.cameras.sample_cameras import (
    DUAL,
    FISHEYE_TERMS,
    FULL_SPHERE,
    PINHOLES,
    RATIONALS,
    dual_lens,
    image_pixels,
    random_points,
)

CAMERAS: dict[str, CameraModel] = {
    "equirectangular": Equirectangular(1920, 960),
    "fisheye": KannalaBrandt(1000, 960, 255.0, 257.0, 498.0, 483.0, **FISHEYE_TERMS, max_angle=np.radians(110.0)),
    "equidistant_full_sphere": FULL_SPHERE,
    "mei": Mei(1280, 960, 409.0, 410.5, 630.3, 431.9, 1.053, -0.0083, 0.0118, 0.0228, -0.0042, np.radians(105.0)),
    "mei_mirror": Mei(800, 800, 620.0, 618.0, 402.0, 399.0, 2.4, -0.15, 0.04, 0.001, -0.002, np.radians(110.0)),
    "mei_perspective": Mei(640, 480, 300.0, 310.0, 322.0, 236.5, 0.0, -0.1, 0.01, 0.001, 0.0005),
    "double_sphere": DoubleSphere(752, 480, 210.0, 211.0, 365.8, 249.4, -0.24, 0.566, np.radians(110.0)),
    "double_sphere_folding": DoubleSphere(1000, 900, 260.0, 262.0, 498.0, 452.0, 0.3, 0.62),
    "double_sphere_rim": DoubleSphere(700, 700, 300.0, 300.0, 350.0, 350.0, 1.3, 0.2),
    "eucm": Eucm(752, 480, 210.0, 211.0, 365.8, 248.9, 0.586, 1.139, np.radians(105.0)),
    "eucm_folding": Eucm(1000, 960, 240.0, 242.0, 498.0, 483.0, 0.66, 0.9),
    "eucm_narrow": Eucm(640, 480, 280.0, 282.0, 318.0, 242.0, 0.3, 1.4),
    **PINHOLES,
    **RATIONALS,
    "dual_fisheye": DUAL,
    "dual_fisheye_overlapping": DualFisheye(
        FisheyeLens(dual_lens(620.0, 481.5), DUAL.front.camera_from_lens),
        FisheyeLens(dual_lens(1300.0, 477.0), DUAL.back.camera_from_lens),
    ),
}
CAMERAS["stitched_dual"] = StitchedEquirectangular(
    1280,
    640,
    StitchedLens(RigidTransform.from_components([0.02, 0.001, 0], Rotation.from_rotvec([0.004, -0.006, 0.003]))),
    StitchedLens(
        RigidTransform.from_components([-0.02, 0, 0.001], Rotation.from_euler("zx", [3.135, 0.01])), 0.01, -0.003
    ),
)
CENTRAL = [name for name in CAMERAS if "dual" not in name]
every_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())
central_camera = pytest.mark.parametrize("camera", [CAMERAS[name] for name in CENTRAL], ids=CENTRAL)


def pixel_distance(camera: CameraModel, a: FloatArray, b: FloatArray) -> FloatArray:
    difference = a - b
    if camera.period_px is not None:
        difference[..., 0] -= camera.period_px * np.round(difference[..., 0] / camera.period_px)
    return np.asarray(np.linalg.norm(difference, axis=-1))


@every_camera
@pytest.mark.parametrize("distance", [0.3, 4.0, 500.0])
def test_project_inverts_unproject_all_over_the_image_and_rays_are_unit_vectors(
    camera: CameraModel, distance: float
) -> None:
    pixels = image_pixels(camera)
    rays = camera.unproject(pixels)
    points = rays.origins + distance * rays.directions
    # Where two lenses overlap, the other one may be responsible for the point.
    own = rays.valid & (camera.centers(points) == rays.origins).all(axis=-1)
    assert own.mean() > 0.3
    np.testing.assert_allclose(np.linalg.norm(rays.directions[rays.valid], axis=-1), 1.0, rtol=1e-14)
    projection = camera.project(points)
    assert projection.valid[own].all()
    assert pixel_distance(camera, projection.pixels[own], pixels[own]).max() < 1e-9


@every_camera
def test_unproject_gives_the_ray_through_a_projected_point(camera: CameraModel) -> None:
    points = random_points(20_000)
    projection = camera.project(points)
    points = points[projection.valid]
    assert len(points) > 500
    rays = camera.unproject(projection.pixels[projection.valid])
    assert rays.valid.all()
    np.testing.assert_array_equal(rays.origins, camera.centers(points))
    along = points - rays.origins
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    # Where a lens is about to fold, pixels hold less of the direction than float64 does.
    assert np.quantile(np.abs(along - rays.directions).max(axis=-1), 0.99) < 1e-12
    assert np.abs(along - rays.directions).max() < 1e-9


@every_camera
@given(direction=st.tuples(*[st.floats(-1.0, 1.0)] * 3), distance=st.floats(0.05, 1e4))
def test_a_point_is_seen_exactly_where_its_pixel_looks(
    camera: CameraModel, direction: tuple[float, float, float], distance: float
) -> None:
    length = math.hypot(*direction)
    # Straight behind, directions across run together; a border of validity lies there for a full sphere.
    assume(length > 1e-6)
    assume(math.hypot(*direction[1:]) > 1e-9 * length)
    point = np.array(direction) * (distance / length)
    projection = camera.project(point)
    if not projection.valid:
        assert np.isnan(projection.pixels).all()
        return
    rays = camera.unproject(projection.pixels)
    assert rays.valid
    np.testing.assert_array_equal(rays.origins, camera.centers(point))
    again = camera.project(rays.origins + np.linalg.norm(point - rays.origins) * rays.directions)
    # At the border of validity rounding decides.
    if again.valid:
        assert pixel_distance(camera, again.pixels, projection.pixels) < 1e-8


@central_camera
@given(scale=st.floats(1e-3, 1e5))
def test_distance_does_not_matter_to_a_camera_with_one_centre(camera: CameraModel, scale: float) -> None:
    points = random_points(50)
    near, far = camera.project(points), camera.project(points * scale)
    np.testing.assert_array_equal(near.valid, far.valid)
    np.testing.assert_allclose(far.pixels, near.pixels, atol=1e-9)
    assert not camera.centers(points).any()


@every_camera
@pytest.mark.parametrize("shape", [(), (0,), (1,), (7,), (4, 5), (2, 0, 3), (2, 3, 4)])
def test_any_leading_shape_is_kept_in_float64(camera: CameraModel, shape: tuple[int, ...]) -> None:
    points = np.broadcast_to(np.array([2.0, 0.1, -0.2]), (*shape, 3))
    projection = camera.project(points)
    assert projection.pixels.shape == (*shape, 2)
    assert np.shape(projection.valid) == shape
    rays = camera.unproject(projection.pixels)
    assert rays.directions.shape == rays.origins.shape == camera.centers(points).shape == (*shape, 3)
    assert np.shape(rays.valid) == shape
    assert np.all(projection.valid)
    assert np.all(rays.valid)
    for array in (projection.pixels, rays.directions, rays.origins, camera.centers(points)):
        assert array.dtype == np.float64
    assert projection.valid.dtype == rays.valid.dtype == np.bool_


@every_camera
def test_memory_layout_and_batching_do_not_matter_and_inputs_are_left_alone(camera: CameraModel) -> None:
    points, pixels = random_points(600), image_pixels(camera, 50.0)
    points.flags.writeable = pixels.flags.writeable = False
    camera.unproject(pixels)
    camera.centers(points)
    together = camera.project(points)
    transposed = camera.project(np.asfortranarray(points).reshape(20, 30, 3))
    np.testing.assert_array_equal(transposed.pixels.reshape(-1, 2), together.pixels)
    one_by_one = np.array([camera.project(point).pixels for point in points[:50]])
    np.testing.assert_allclose(one_by_one, together.pixels[:50], rtol=1e-13)


@every_camera
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_what_is_not_finite_is_not_seen(camera: CameraModel, bad: float, axis: int) -> None:
    points = np.full((3, 3), [2.0, 0.1, 0.2])
    points[1, axis] = bad
    projection = camera.project(points)
    np.testing.assert_array_equal(projection.valid, [True, False, True])
    np.testing.assert_array_equal(np.isnan(projection.pixels).any(axis=-1), [False, True, False])
    pixels = projection.pixels.copy()
    pixels[1] = pixels[0]
    pixels[1, axis % 2] = bad
    rays = camera.unproject(pixels)
    np.testing.assert_array_equal(rays.valid, [True, False, True])
    np.testing.assert_array_equal(np.isnan(rays.directions).all(axis=-1), [False, True, False])


@every_camera
def test_the_origin_is_not_seen_and_pixels_off_the_image_see_nothing(camera: CameraModel) -> None:
    projection = camera.project(np.zeros((2, 3)))
    assert not projection.valid.any()
    assert np.isnan(projection.pixels).all()
    middle = (camera.width / 2, camera.height / 2)
    off = [(middle[0], -0.6), (middle[0], camera.height - 0.4)]
    if camera.period_px is None:
        off += [(-0.6, middle[1]), (camera.width - 0.4, middle[1])]
    rays = camera.unproject(np.array(off))
    assert not rays.valid.any()
    assert np.isnan(rays.directions).all()


@every_camera
def test_projected_pixels_lie_on_the_image(camera: CameraModel) -> None:
    projection = camera.project(random_points(20_000, seed=1))
    u, v = projection.pixels[projection.valid].T
    assert min(u.min(), v.min()) >= -0.5
    assert u.max() <= camera.width - 0.5
    assert v.max() <= camera.height - 0.5
    assert np.isnan(projection.pixels[~projection.valid]).all()


@central_camera
def test_right_and_down_are_those_of_the_world_and_the_optical_axis_hits_the_stated_centre(
    camera: CameraModel,
) -> None:
    ahead, right, below = camera.project(np.array([[1.0, 0, 0], [1.0, -0.01, 0], [1.0, 0, -0.01]])).pixels
    assert right[0] > ahead[0] + 0.5
    assert abs(right[1] - ahead[1]) < 0.1
    assert below[1] > ahead[1] + 0.5
    assert abs(below[0] - ahead[0]) < 0.1
    if isinstance(camera, KannalaBrandt | Pinhole | RationalPinhole | Mei | DoubleSphere | Eucm):
        centre = [camera.cx, camera.cy]
    else:
        centre = [(camera.width - 1) / 2, (camera.height - 1) / 2]
    np.testing.assert_allclose(camera.project(np.array([3.0, 0, 0])).pixels, centre, atol=1e-12)
    np.testing.assert_allclose(camera.unproject(np.array(centre)).directions, [1.0, 0, 0], atol=1e-15)
