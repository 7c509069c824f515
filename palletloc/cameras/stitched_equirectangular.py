"""A stitched 360-degree image as what it is: the images of two lenses, each with its own place and bend."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.cameras.equirectangular import Equirectangular
from palletloc.cameras.image_area import blank_invalid
from palletloc.cameras.odd_polynomial import OddPolynomial
from palletloc.cameras.protocol import Projection, Rays
from palletloc.geometry import BoolArray, FloatArray

_SIGNS = np.array([1.0, -1.0])
"""Of the lenses' axes along the camera's x."""
_HALF = np.pi / 2
"""How far a lens reaches in the image, in radians."""


@dataclass(frozen=True, slots=True)
class StitchedLens:
    """One of the lenses behind a stitched image."""

    camera_from_lens: RigidTransform
    """Where it is; its axis is its x. With the stitcher's own idea of it, the front lens is the camera frame and the
    back lens is turned by 180 degrees about the vertical."""
    k1: float = 0.0
    """A point at the angle theta off the lens's axis was stitched at ``theta (1 + k1 theta^2 + k2 theta^4)``."""
    k2: float = 0.0
    """The coefficient of theta^5 there."""


@dataclass(frozen=True, slots=True)
class StitchedEquirectangular:
    """An equirectangular image whose front half one lens took, and whose back half another.

    Columns within a quarter of the width from the middle are the front lens's. A point belongs to the lens whose
    axis is nearer in direction, seen from the camera's origin.

    Raises
    ------
    ValueError
        If a lens's image folds within its half, or both lenses look the same way.
    """

    width: int
    """Image width in pixels, 360 degrees."""
    height: int
    """Image height in pixels, 180 degrees."""
    front: StitchedLens
    """Of the image's middle."""
    back: StitchedLens
    """Of its left and right margin."""
    _whole: Equirectangular = field(init=False, repr=False, compare=False)
    _bends: tuple[OddPolynomial, OddPolynomial] = field(init=False, repr=False, compare=False)
    _poses: FloatArray = field(init=False, repr=False, compare=False)
    _towards_front: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Refuse lenses that fold or cannot be distinguished, and prepare how to distinguish them."""
        bends = tuple(OddPolynomial((lens.k1, lens.k2)) for lens in (self.front, self.back))
        for name, bend in zip(("front", "back"), bends, strict=True):
            end = bend.increasing_until()
            if end <= np.pi and end * float(bend.factor(np.asarray(end * end))) <= _HALF:
                raise ValueError(f"the image of the {name} lens folds at {np.degrees(end):.1f} degrees off its axis")
        poses = np.stack([lens.camera_from_lens.as_matrix() for lens in (self.front, self.back)])
        towards_front = poses[0, :3, 0] - poses[1, :3, 0]
        if not towards_front.any():
            raise ValueError("the two lenses must differ in their axis")
        object.__setattr__(self, "_whole", Equirectangular(self.width, self.height))
        object.__setattr__(self, "_bends", bends)
        object.__setattr__(self, "_poses", poses)
        object.__setattr__(self, "_towards_front", towards_front)

    @property
    def period_px(self) -> float | None:
        """The image closes around after its width."""
        return self._whole.period_px

    def project(self, points_camera: FloatArray) -> Projection:
        """Project points to pixels; their distance counts. See `CameraModel.project`."""
        points = np.asarray(points_camera, dtype=np.float64)
        directions = np.empty(points.shape)
        with np.errstate(invalid="ignore", over="ignore"):
            front = self._sees_front(points)
            for lens, mine in ((0, front), (1, ~front)):
                pose = self._poses[lens]
                directions[mine] = self._stitched(lens, (points[mine] - pose[:3, 3]) @ pose[:3, :3])
        pixels, valid = self._whole.project(directions)
        valid &= self._shown_by_front(pixels) == front
        valid &= np.isfinite(points).all(-1) & points.any(-1)
        blank_invalid(pixels, valid)
        return Projection(pixels, valid)

    def unproject(self, pixels: FloatArray) -> Rays:
        """Return the rays that pixels look along, from its lens's centre. See `CameraModel.unproject`."""
        pixels = np.asarray(pixels, dtype=np.float64)
        stitched, _, valid = self._whole.unproject(pixels)
        front = self._shown_by_front(pixels)
        directions = np.empty(stitched.shape)
        for lens, mine in ((0, front), (1, ~front)):
            directions[mine] = self._unstitched(lens, stitched[mine]) @ self._poses[lens, :3, :3].T
        valid &= np.isfinite(directions).all(-1)
        blank_invalid(directions, valid)
        return Rays(directions, self._centers_where(front), valid)

    def centers(self, points_camera: FloatArray) -> FloatArray:
        """Return the centre of each point's lens. See `CameraModel.centers`."""
        with np.errstate(invalid="ignore", over="ignore"):
            return self._centers_where(self._sees_front(np.asarray(points_camera)))

    def _stitched(self, lens: int, rays: FloatArray) -> FloatArray:
        """Return where the stitcher put rays of a lens, as directions in the camera frame."""
        across = np.hypot(rays[:, 1], rays[:, 2])
        angle = np.arctan2(across, rays[:, 0])
        return self._at(lens, rays, across, angle * self._bends[lens].factor(angle * angle))

    def _unstitched(self, lens: int, directions: FloatArray) -> FloatArray:
        """Return the rays of a lens that the stitcher put there; NaN where there are none."""
        across = np.hypot(directions[:, 1], directions[:, 2])
        placed = np.arctan2(across, np.abs(directions[:, 0]))
        bend = self._bends[lens]
        angle = bend.inverse(placed, min(bend.increasing_until(), np.pi))
        turned = directions * np.array([_SIGNS[lens], _SIGNS[lens], 1.0])
        level = np.sin(angle) / np.maximum(across, np.finfo(np.float64).tiny)
        return np.stack([np.cos(angle), level * turned[:, 1], level * turned[:, 2]], axis=-1)

    @staticmethod
    def _at(lens: int, rays: FloatArray, across: FloatArray, angle: FloatArray) -> FloatArray:
        """Return directions at an angle off a lens's nominal axis, around it like rays."""
        level = np.sin(angle) / np.maximum(across, np.finfo(np.float64).tiny)
        sign = _SIGNS[lens]
        return np.stack([sign * np.cos(angle), sign * level * rays[:, 1], level * rays[:, 2]], axis=-1)

    def _sees_front(self, points: FloatArray) -> BoolArray:
        front: BoolArray = points @ self._towards_front >= 0
        return front

    def _shown_by_front(self, pixels: FloatArray) -> BoolArray:
        """Return which columns are nearer to the middle than to the margins."""
        with np.errstate(invalid="ignore"):
            turns = (pixels[..., 0] + 0.5) / self.width - 0.5
            front: BoolArray = np.abs(turns - np.round(turns)) <= 0.25
        return front

    def _centers_where(self, front: BoolArray) -> FloatArray:
        """Return the front lens's centre where True, the back lens's elsewhere."""
        return self._poses[np.where(front, 0, 1), :3, 3]
