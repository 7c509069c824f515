"""Two fisheye lenses back to back: the raw image of a 360-degree camera, before stitching."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import EllipsisType

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.cameras.image_area import blank_invalid
from palletloc.cameras.kannala_brandt import KannalaBrandt
from palletloc.cameras.protocol import Projection, Rays
from palletloc.geometry import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class FisheyeLens:
    """One of the lenses: how it maps, and where it sits."""

    model: KannalaBrandt
    """The mapping to pixels of the whole image; its size is that of the whole image."""
    camera_from_lens: RigidTransform
    """The lens's own frame: its optical axis is x, the image's right is -y, its down is -z."""


@dataclass(frozen=True, slots=True)
class DualFisheye:
    """Two fisheye lenses in one image, each with its own optical centre.

    A point belongs to the lens whose axis is nearer in direction, seen from the camera's origin; a pixel
    to the lens whose optical axis is nearer in the image. Where the lenses overlap, a pixel of one may
    therefore look at points that `project` sends to the other.

    Raises
    ------
    ValueError
        If the lenses differ in image size, or share their axis or its pixel.
    """

    front: FisheyeLens
    """The lens that looks forward, as a rule."""
    back: FisheyeLens
    """The other one."""
    _towards_front: FloatArray = field(init=False, repr=False, compare=False)
    _centers: FloatArray = field(init=False, repr=False, compare=False)
    _lenses_from_camera: FloatArray = field(init=False, repr=False, compare=False)
    _image_split: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Refuse lenses that cannot be distinguished, and prepare how to distinguish them."""
        front, back = self.front.model, self.back.model
        if (front.width, front.height) != (back.width, back.height):
            raise ValueError(
                f"both lenses must give the size of the whole image, got {front.width} x {front.height} "
                f"and {back.width} x {back.height}"
            )
        poses = np.stack([lens.camera_from_lens.as_matrix() for lens in (self.front, self.back)])
        inverses = np.stack([lens.camera_from_lens.inv().as_matrix() for lens in (self.front, self.back)])
        towards_front = poses[0, :3, 0] - poses[1, :3, 0]
        split = np.array([front.cx - back.cx, front.cy - back.cy, 0.0])
        if not (towards_front.any() and split.any()):
            raise ValueError("the two lenses must differ in their axis and in its pixel")
        split[2] = -(split[0] * (front.cx + back.cx) + split[1] * (front.cy + back.cy)) / 2
        object.__setattr__(self, "_towards_front", _read_only(towards_front))
        object.__setattr__(self, "_centers", _read_only(poses[:, :3, 3]))
        object.__setattr__(self, "_lenses_from_camera", _read_only(inverses))
        object.__setattr__(self, "_image_split", _read_only(split))

    @property
    def width(self) -> int:
        """Image width in pixels."""
        return self.front.model.width

    @property
    def height(self) -> int:
        """Image height in pixels."""
        return self.front.model.height

    @property
    def period_px(self) -> float | None:
        """The image does not close around."""
        return None

    def project(self, points_camera: FloatArray) -> Projection:
        """Project points to pixels; their distance counts. See `CameraModel.project`."""
        points = np.asarray(points_camera, dtype=np.float64)
        pixels = np.empty((*points.shape[:-1], 2))
        valid = np.empty(points.shape[:-1], dtype=np.bool_)
        with np.errstate(invalid="ignore", over="ignore"):
            sees_front = points @ self._towards_front >= 0
        for lens, mine in self._shares(sees_front):
            lens_from_camera = self._lenses_from_camera[lens]
            with np.errstate(invalid="ignore", over="ignore"):
                points_lens = points[mine] @ lens_from_camera[:3, :3].T + lens_from_camera[:3, 3]
            pixels[mine], valid[mine] = self._model(lens).project(points_lens)
        valid &= self._shown_by_front(pixels) == sees_front
        valid &= (points[..., 0] != 0) | (points[..., 1] != 0) | (points[..., 2] != 0)
        blank_invalid(pixels, valid)
        return Projection(pixels, valid)

    def unproject(self, pixels: FloatArray) -> Rays:
        """Return the rays that pixels look along, from its lens's centre. See `CameraModel.unproject`."""
        pixels = np.asarray(pixels, dtype=np.float64)
        directions = np.empty((*pixels.shape[:-1], 3))
        valid = np.empty(pixels.shape[:-1], dtype=np.bool_)
        shown_by_front = self._shown_by_front(pixels)
        for lens, mine in self._shares(shown_by_front):
            directions_lens, _, valid[mine] = self._model(lens).unproject(pixels[mine])
            directions[mine] = directions_lens @ self._lenses_from_camera[lens, :3, :3]
        return Rays(directions, self._centers_where(shown_by_front), valid)

    def centers(self, points_camera: FloatArray) -> FloatArray:
        """Return the centre of each point's lens. See `CameraModel.centers`."""
        with np.errstate(invalid="ignore", over="ignore"):
            return self._centers_where(np.asarray(points_camera) @ self._towards_front >= 0)

    def _model(self, lens: int) -> KannalaBrandt:
        return (self.front, self.back)[lens].model

    def _centers_where(self, front: BoolArray) -> FloatArray:
        """Return the front lens's centre where True, the back lens's elsewhere."""
        return self._centers[np.where(front, 0, 1)]

    def _shown_by_front(self, pixels: FloatArray) -> BoolArray:
        """Return which pixels are nearer to the front lens's axis than to the back lens's."""
        a, b, c = self._image_split
        with np.errstate(invalid="ignore", over="ignore"):
            front: BoolArray = a * pixels[..., 0] + b * pixels[..., 1] + c >= 0
        return front

    @staticmethod
    def _shares(front: BoolArray) -> list[tuple[int, BoolArray | EllipsisType]]:
        """Return the lenses that have any share, each with the index of its own."""
        if front.all():
            return [(0, ...)]
        if not front.any():
            return [(1, ...)]
        return [(0, front), (1, ~front)]


def _read_only(values: FloatArray) -> FloatArray:
    values.flags.writeable = False
    return values
