"""Pictures of a scene through any camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from palletloc.geometry import BoolArray
from palletloc.synthetic.rays import CameraRays, finer_rays
from palletloc.synthetic.samples import Samples
from palletloc.synthetic.shading import LitScene, look

UNSEEN = -4
"""What the solids' map holds where the image shows nothing."""

_CONTRAST = 0.12
_FLOOR_OF_CONTRAST = 0.02
_OFFSETS = np.array([[-0.125, -0.375], [0.375, -0.125], [-0.375, 0.125], [0.125, 0.375]])


@dataclass(frozen=True, slots=True)
class Picture:
    """What a camera sees, before its sensor."""

    radiance: Samples
    """(height, width, 3) blue, green, red in linear light; zero where the image shows nothing."""
    solids: NDArray[np.int32]
    """(height, width) index of the solid at each pixel's centre, a part of the room, or `UNSEEN`."""


def render(scene: LitScene, rays: CameraRays, world_from_camera: RigidTransform, smooth: bool = True) -> Picture:
    """Return the picture that a camera takes of a scene.

    A pixel's value is the mean over its area where something changes within it, else that of its centre.

    Parameters
    ----------
    scene : LitScene
        The scene.
    rays : CameraRays
        The camera's rays, as `camera_rays` gives them; they serve for any number of pictures.
    world_from_camera : RigidTransform
        Where it is.
    smooth : bool
        Whether to take several rays through pixels that something changes in.

    Returns
    -------
    Picture
        Linear light, and which solid is where.
    """
    matrix = world_from_camera.as_matrix()
    rotation, translation = matrix[:3, :3], matrix[:3, 3]
    height, width = rays.camera.height, rays.camera.width
    light, things = np.zeros((height * width, 3), np.float32), np.full(height * width, UNSEEN, np.int32)
    for part in rays.parts:
        radiance, hits = look(scene, part.rays.moved(rotation, translation), rays.angle)
        things[part.pixels] = hits.solids
        light[part.pixels] = radiance.T
    image, solids = light.reshape(height, width, 3), things.reshape(height, width)
    if smooth:
        changed = _changes(image, solids, rays.camera.period_px is not None).ravel()
        for part in rays.parts:
            chosen = changed[part.pixels]
            finer = finer_rays(rays.camera, part, chosen, _OFFSETS).moved(rotation, translation)
            radiance, _ = look(scene, finer, rays.angle / 2)
            light[part.pixels[chosen]] = radiance.reshape(3, -1, len(_OFFSETS)).mean(axis=2).T
    return Picture(image, solids)


def _changes(image: Samples, solids: NDArray[np.int32], closed: bool) -> BoolArray:
    """Return the pixels that differ from a neighbour; in a closed image the first column follows the last."""
    light = np.log(image[:, :, 1] + np.float32(_FLOOR_OF_CONTRAST))
    changed = np.zeros(solids.shape, np.bool_)
    for axis in (0, 1):
        differs = np.abs(light - np.roll(light, 1, axis)) > _CONTRAST
        differs |= solids != np.roll(solids, 1, axis)
        if not (closed and axis == 1):
            differs[(slice(None),) * axis + (0,)] = False
        changed |= differs | np.roll(differs, -1, axis)
    return changed
