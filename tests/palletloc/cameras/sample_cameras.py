"""Cameras, pixels and points that several tests of cameras share."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.cameras import CameraModel, DualFisheye, FisheyeLens, KannalaBrandt, Pinhole, RationalPinhole
from palletloc.geometry import FloatArray

FISHEYE_TERMS = {"k1": 0.03, "k2": -0.012, "k3": 0.002, "k4": -0.0002}
BROWN_TERMS = {"k1": -0.28, "k2": 0.09, "p1": 0.002, "p2": -0.0015, "k3": -0.012}


def dual_lens(cx: float, cy: float) -> KannalaBrandt:
    return KannalaBrandt(1920, 960, 280.0, 282.0, cx, cy, **FISHEYE_TERMS, max_angle=np.radians(96.0))


DUAL = DualFisheye(
    FisheyeLens(
        dual_lens(478.0, 481.5),
        RigidTransform.from_components([0.012, 0.001, -0.002], Rotation.from_rotvec([0.01, -0.02, 0.005])),
    ),
    FisheyeLens(
        dual_lens(1441.0, 477.0),
        RigidTransform.from_components([-0.013, 0.0, 0.001], Rotation.from_euler("zx", [3.13, 0.02])),
    ),
)
PINHOLES = {
    "pinhole": Pinhole(640, 480, 300.0, 310.0, 322.0, 236.5),
    "brown": Pinhole(800, 600, 520.0, 525.0, 405.0, 296.0, **BROWN_TERMS),
    "brown_folding": Pinhole(800, 600, 300.0, 300.0, 405.0, 296.0, k1=-0.25, p1=0.01, p2=-0.008),
    "pincushion": Pinhole(800, 600, 400.0, 400.0, 400.0, 300.0, k1=0.2, p1=-0.003, k3=0.05),
}
RATIONAL_TERMS = (0.35, -0.12, 0.0012, -0.0008, 0.03, 0.61, -0.05, 0.02)
RATIONALS = {
    "rational": RationalPinhole(1200, 1000, 520.0, 525.0, 605.0, 496.0, *RATIONAL_TERMS),
    "rational_wide": RationalPinhole(1200, 1000, 420.0, 424.0, 598.0, 503.0, 6.5, 2.4, 0.0, 0.0, 0.08, 6.8, 4.1, 0.6),
    "rational_folding": RationalPinhole(800, 600, 300.0, 300.0, 405.0, 296.0, k1=0.1, p1=0.01, p2=-0.008, k4=0.6),
}
FULL_SPHERE = KannalaBrandt(900, 900, 140.0, 140.0, 449.5, 449.5, max_angle=np.pi)


def image_pixels(camera: CameraModel, step: float = 7.3) -> FloatArray:
    u, v = np.meshgrid(np.arange(0, camera.width, step), np.arange(0, camera.height, step))
    return np.stack([u, v], axis=-1)


def random_points(count: int, seed: int = 0) -> FloatArray:
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return np.asarray(directions * rng.uniform(0.3, 20.0, size=(count, 1)))


def opencv_points(points_camera: FloatArray) -> FloatArray:
    return np.stack([-points_camera[..., 1], -points_camera[..., 2], points_camera[..., 0]], axis=-1)
