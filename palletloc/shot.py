"""A shot: an image with the camera that took it, its mounting and its time, and every view of a plane in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.cameras.protocol import CameraModel, Projection
from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.measurement import Reason
from palletloc.mounting import Mounting
from palletloc.plane import (
    FACE_IN_PALLET,
    PALLET_FROM_HORIZONTAL,
    PALLET_FROM_VERTICAL,
    PlaneGrid,
    PlaneView,
    place_plane,
)
from palletloc.projection import Interpolation, Projector
from palletloc.shelf import ShelfPlane

MIN_DISTANCE = 0.2
"""Least distance of the camera from a plane that is viewed, in metres: nearer, it is seen at a grazing angle."""
BRIGHT = 200.0
"""Gray level that the brightest parts of the shelf shall have: below the level at which cameras saturate."""
BRIGHTEST = 98.0
"""Percentile of the gray levels about the shelf that counts as its brightest: lamps and reflections are more so."""
LEAST_GAIN, MOST_GAIN = 1.5, 12.0
"""Gain from which on brightening is worth its time, and the largest one: beyond, there is only noise."""
SURROUNDINGS = 1.0
"""How far around given places the light is looked at, in metres: about the width of a pallet."""
LIGHT_STEP = 0.15
"""How far apart the light is looked at, in metres: about the height of a pallet's face."""

Extent = tuple[float, float, float, float]
"""Part of a plane around a pallet's origin: left, right, low and high, in metres."""


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """An image with all that is needed to look at planes in it.

    Examples
    --------
    >>> from palletloc.cameras import Equirectangular
    >>> mounting = Mounting(RigidTransform.from_translation([0.3, 0.0, 1.8]))
    >>> shot = Shot(np.full((256, 512, 3), 7, np.uint8), Equirectangular(512, 256), mounting, 2.5, "1.jpg")
    >>> pose = LevelPose(2.0, 1.5, 0.0, np.pi / 2)
    >>> shot.camera_in(pose).round(3).tolist()
    [-1.7, 1.8, 1.5]
    >>> shot.vertical_view(pose, (-0.6, 0.6, 0.0, 0.15), 0.01).image.shape
    (16, 121, 3)
    """

    image: Image
    """(height, width) gray or (height, width, 3) in blue-green-red order."""
    camera: CameraModel
    """The camera that took it."""
    mounting: Mounting
    """Of that camera on the forklift."""
    time: float = 0.0
    """When it was exposed, in seconds."""
    file: str = ""
    """Its name, for results and messages."""
    projector: Projector = field(init=False, repr=False)
    """Its views of planes; keeps their tables. A shot is not to be shared by threads for it."""

    def __post_init__(self) -> None:
        """Make the projector."""
        object.__setattr__(self, "projector", Projector(self.camera))

    def camera_in(self, pose: LevelPose) -> FloatArray:
        """Return the camera's centre in the coordinates of a pallet's face: right, up and towards the viewer.

        Parameters
        ----------
        pose : LevelPose
            ``forklift_from_pallet``.

        Returns
        -------
        (3,) array
            In metres; the last one is negative where the camera is behind the face.
        """
        forklift_from_face = pose.matrix() @ FACE_IN_PALLET
        return np.asarray(forklift_from_face[:3, :3].T @ (self.mounting.center - forklift_from_face[:3, 3]))

    def camera_from_face(self, pose: LevelPose) -> FloatArray:
        """Return the plane of a pallet's face in the camera's frame, (4, 4): x right, y up."""
        return np.asarray(self.mounting.camera_from_forklift @ pose.matrix() @ FACE_IN_PALLET)

    def project(self, points: FloatArray) -> Projection:
        """Return where points appear in the image.

        Parameters
        ----------
        points : (..., 3) array
            In the forklift frame, in metres.

        Returns
        -------
        Projection
            Pixels, and whether the camera sees the points.
        """
        matrix = self.mounting.camera_from_forklift
        return self.camera.project(points @ matrix[:3, :3].T + matrix[:3, 3])

    def vertical_view(self, pose: LevelPose, extent: Extent, resolution: float) -> PlaneView:
        """Project the shot on the vertical plane of a pallet's face.

        Parameters
        ----------
        pose : LevelPose
            ``forklift_from_pallet``: the plane goes through its front.
        extent : (left, right, low, high)
            The part of the plane around the pallet's origin, in metres.
        resolution : float
            Metres per pixel.

        Returns
        -------
        PlaneView
            With its validity; the camera should be `MIN_DISTANCE` before the plane.
        """
        return self._view(pose, PALLET_FROM_VERTICAL, extent, resolution)

    def horizontal_view(self, pose: LevelPose, extent: Extent, resolution: float) -> PlaneView:
        """Project the shot on the horizontal plane at a pose's height; parameters as for `vertical_view`.

        Low and high count into the pallet.
        """
        return self._view(pose, PALLET_FROM_HORIZONTAL, extent, resolution)

    def _view(
        self, pose: LevelPose, pallet_from_plane: RigidTransform, extent: Extent, resolution: float
    ) -> PlaneView:
        camera_from_plane = place_plane(self.mounting.to_camera, pose, pallet_from_plane)
        grid = PlaneGrid.spanning(*extent, resolution)
        return self.projector.view(self.image, camera_from_plane, grid, Interpolation.LINEAR)

    def exposed_for(self, points: FloatArray) -> Shot:
        """Return the shot as if it had been exposed for what it is to measure.

        Steps that round to whole gray levels would lose most of what little contrast a dark shot has.

        Parameters
        ----------
        points : (n, 3) array
            Places in the forklift frame that it shall be exposed for, in metres.

        Returns
        -------
        Shot
            The shot itself where it is bright enough there.
        """
        seen = self.project(points)
        height, width = self.image.shape[:2]
        columns, rows = np.rint(seen.pixels[seen.valid]).astype(np.intp).T
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        if not inside.any():
            return self
        colours = self.image[rows[inside], columns[inside]].reshape(int(np.count_nonzero(inside)), -1)
        levels = np.sort(colours.max(axis=1))
        brightest = float(np.interp(BRIGHTEST / 100 * (len(levels) - 1), np.arange(len(levels)), levels))
        gain = BRIGHT / max(brightest, 1.0)
        if gain < LEAST_GAIN:
            return self
        image = np.asarray(cv2.convertScaleAbs(self.image, alpha=min(gain, MOST_GAIN)), dtype=np.uint8)
        return Shot(image, self.camera, self.mounting, self.time, self.file)


def out_of_sight(camera: FloatArray, farthest: float) -> Reason | None:
    """Tell why a pallet's face cannot be seen from a place.

    Parameters
    ----------
    camera : (3,) array
        The camera's centre in the face's coordinates, from `Shot.camera_in`, in metres.
    farthest : float
        How far away the face may be on the floor, in metres.

    Returns
    -------
    Reason or None
        `Reason.OUT_OF_RANGE`, `Reason.BEHIND_FACE` or None.
    """
    aside, _, before = camera
    if np.hypot(aside, before) > farthest:
        return Reason.OUT_OF_RANGE
    return Reason.BEHIND_FACE if before < MIN_DISTANCE else None


def shelf_points(shelf: ShelfPlane, heights: tuple[float, float], reach: float) -> FloatArray:
    """Return points all over a shelf's front.

    Parameters
    ----------
    shelf : ShelfPlane
        In the forklift frame.
    heights : (float, float)
        Lowest and highest, in metres.
    reach : float
        How far to both sides of the place nearest to the forklift, in metres.

    Returns
    -------
    (n, 3) array
        In the forklift frame.
    """
    out = np.array([np.cos(shelf.facing), np.sin(shelf.facing)])
    foot = out * (out @ [shelf.x, shelf.y])
    along, up = np.meshgrid(np.arange(-reach, reach, LIGHT_STEP), np.arange(*heights, LIGHT_STEP))
    floor = foot + along.reshape(-1, 1) * np.array([-out[1], out[0]])
    return np.column_stack([floor, up.ravel()])


def points_about(poses: Sequence[LevelPose]) -> FloatArray:
    """Return points around given places.

    Parameters
    ----------
    poses : sequence of LevelPose
        ``forklift_from_pallet``.

    Returns
    -------
    (n, 3) array
        In the forklift frame.
    """
    return np.concatenate([_AROUND @ pose.matrix()[:3, 1:3].T + (pose.x, pose.y, pose.z) for pose in poses])


def _around() -> FloatArray:
    """Return points on and around a face, (n, 2): left and up, in metres."""
    left, up = np.meshgrid(
        np.arange(-SURROUNDINGS, SURROUNDINGS, LIGHT_STEP), np.arange(-LIGHT_STEP, 2 * LIGHT_STEP, LIGHT_STEP / 2)
    )
    return np.stack([left.ravel(), up.ravel()], axis=1)


_AROUND = _around()
"""Places around a face where the light is looked at, (n, 2): left and up, in metres."""
