"""The camera's mounting on the forklift, and how well it is known."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.geometry import FloatArray


@dataclass(frozen=True, slots=True)
class Mounting:
    """Where the camera sits, with the uncertainty of its calibration."""

    forklift_from_camera: RigidTransform
    """The camera's pose."""
    translation_sigma: tuple[float, float, float] = (0.0005, 0.0005, 0.0005)
    """Standard deviations along the forklift's axes, in metres."""
    rotation_sigma: tuple[float, float, float] = (0.0002, 0.0002, 0.0002)
    """Standard deviations about the forklift's axes, in radians."""
    center: FloatArray = field(init=False, repr=False, compare=False)
    """The camera's origin in the forklift frame, (3,), in metres; read-only."""
    camera_from_forklift: FloatArray = field(init=False, repr=False, compare=False)
    """The inverse of the camera's pose as a (4, 4) matrix; read-only."""
    to_camera: RigidTransform = field(init=False, repr=False, compare=False)
    """The same as a transform."""

    def __post_init__(self) -> None:
        """Compute what every step asks for."""
        forward = self.forklift_from_camera.as_matrix()
        center, inverse = forward[:3, 3], np.eye(4)
        inverse[:3, :3] = forward[:3, :3].T
        inverse[:3, 3] = -forward[:3, :3].T @ center
        for name, array in (("center", center), ("camera_from_forklift", inverse)):
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        object.__setattr__(self, "to_camera", self.forklift_from_camera.inv())

    @property
    def sigma(self) -> FloatArray:
        """(6,) standard deviations: three translations, three rotations."""
        return np.array([*self.translation_sigma, *self.rotation_sigma])
