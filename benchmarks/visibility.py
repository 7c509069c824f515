"""How much of a pallet's face a simulated shot shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from palletloc.cameras.protocol import CameraModel
from palletloc.geometry import FloatArray
from palletloc.pallet import PalletModel
from palletloc.synthetic.pallet_solid import PalletBody
from palletloc.synthetic.simulation import Simulation

_COLUMNS, _ROWS = 60, 12
_INSET = 0.004
_WINDOW = (-1, 0, 1)


def face_points(model: PalletModel) -> FloatArray:
    """Return points spread over the solid parts of a face, (n, 3) in the pallet frame, in metres."""
    half = model.width / 2 - _INSET
    y = np.linspace(-half, half, _COLUMNS)
    z = np.linspace(_INSET, model.height - _INSET, _ROWS)
    right, up = (grid.ravel() for grid in np.meshgrid(-y, z))
    solid = np.ones(len(right), np.bool_)
    for opening in model.openings:
        outside = (right < opening.left - _INSET) | (right > opening.right + _INSET)
        solid &= outside | (up < opening.bottom - _INSET) | (up > opening.top + _INSET)
    return np.stack([np.zeros(solid.sum()), -right[solid], up[solid]], -1)


def hidden_share(
    camera: CameraModel, solids: NDArray[np.int32], body: int, camera_from_pallet: RigidTransform, model: PalletModel
) -> float | None:
    """Return how much of a face's solid parts something stands before.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    solids : (height, width) array
        What its picture shows at each pixel.
    body : int
        What the pallet is in it.
    camera_from_pallet : RigidTransform
        The true pose.
    model : PalletModel
        As drawn: what a misfit adds does not matter here.

    Returns
    -------
    float or None
        0 to 1; None where the image's border, or the limit of a lens, cuts the face.
    """
    pixels, valid = camera.project(camera_from_pallet.apply(face_points(model)))
    if not valid.all():
        return None
    u, v = np.round(pixels).astype(int).T
    seen = np.zeros(len(u), np.bool_)
    for down in _WINDOW:
        for right in _WINDOW:  # thin boards are hardly a pixel high
            row, column = np.clip(v + down, 0, camera.height - 1), u + right
            column = column % camera.width if camera.period_px is not None else np.clip(column, 0, camera.width - 1)
            seen |= solids[row, column] == body
    return 1.0 - float(seen.mean())


def hidden_shares(simulation: Simulation, shot: int, solids: NDArray[np.int32]) -> list[float | None]:
    """Return the `hidden_share` of every pallet beside the path in one shot, in their order."""
    bodies = [index for index, solid in enumerate(simulation.aisle.scene.solids) if isinstance(solid, PalletBody)]
    world_from_forklift = simulation.truth.pose_at(float(simulation.times[shot])).transform()
    camera_from_world = (world_from_forklift * simulation.forklift_from_camera).inv()
    return [
        hidden_share(
            simulation.camera, solids, body, camera_from_world * pallet.world_from_pallet.transform(), pallet.model
        )
        # the rack beside the path is built first, the one across the aisle after it
        for body, pallet in zip(bodies, simulation.aisle.pallets, strict=False)
    ]
