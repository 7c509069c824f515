"""The front face as the camera sees it: a picture to look between its edges."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.face import EdgeKind, FaceLine, face_lines
from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.measurement import Reason
from palletloc.pallet import PalletModel
from palletloc.plane import PALLET_FROM_VERTICAL, PlaneGrid, PlaneView, place_plane
from palletloc.projection import Interpolation, Projector

MIN_DISTANCE = 0.2
"""Least distance of the camera from the face's plane, in metres."""
MARGIN = 0.06
"""How far the view reaches beyond the face, in metres."""


def view_face(
    projector: Projector,
    image: Image,
    camera_from_forklift: RigidTransform,
    pose: LevelPose,
    model: PalletModel,
    resolution: float,
) -> PlaneView | Reason:
    """Project the shot on the plane of the face.

    Parameters
    ----------
    projector : Projector
        Of the camera that took the image.
    image : Image
        The shot.
    camera_from_forklift : RigidTransform
        Inverse of the camera's mounting.
    pose : LevelPose
        ``forklift_from_pallet``.
    model : PalletModel
        The pallet.
    resolution : float
        Metres per pixel of the view.

    Returns
    -------
    PlaneView or Reason
        `Reason.BEHIND_FACE` or `Reason.OUT_OF_VIEW` where the face is not wholly seen.
    """
    camera_from_plane = place_plane(camera_from_forklift, pose, PALLET_FROM_VERTICAL)
    camera = np.asarray(camera_from_plane.inv().translation)
    if camera[2] < MIN_DISTANCE:
        return Reason.BEHIND_FACE
    half = model.width / 2 + MARGIN
    grid = PlaneGrid.spanning(-half, half, -MARGIN, model.height + MARGIN, resolution)
    view = projector.view(image, camera_from_plane, grid, Interpolation.LINEAR)
    if not view.valid.all():
        return Reason.OUT_OF_VIEW
    return view


def visible_lines(model: PalletModel, plane_from_camera: FloatArray) -> list[FaceLine]:
    """Return the lines to measure: from below, a beam hides the lower edge and would be taken for it."""
    below = plane_from_camera[1] < 0
    return [line for line in face_lines(model) if not (below and line.kind is EdgeKind.BOTTOM)]
