"""A pose, priors and motions that tests of the localizer share, and the types of their fixtures."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc import Fit, LevelPose, Localizer, LocalizerConfig, PalletModel, Refusal, Shot
from palletloc.geometry import Image
from palletloc.measurement import HeightPrior
from palletloc.plane import PlaneView

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
"""Of a pallet on the floor, to the left of the forklift."""
FLOOR = HeightPrior(0.0, 0.003)
Height = HeightPrior | None
CONFIG = LocalizerConfig()
Portrait = Callable[..., Shot]
Photograph = Callable[..., Shot]
Mounted = Callable[..., RigidTransform]
Draw = Callable[..., PlaneView]
Shoots = Callable[..., Image]
Paints = Callable[..., Image]
Makes = Callable[..., Localizer]
Outcome = Fit | Refusal
Placed = tuple[PalletModel, LevelPose]
"""A pallet where it stands in the forklift frame."""
Pallets = tuple[Placed, ...]
Models = tuple[PalletModel, ...]
WritePallets = Callable[[str | bytes], Path]


def moved(
    pose: LevelPose, right: float = 0.0, depth: float = 0.0, up: float = 0.0, turn_deg: float = 0.0
) -> LevelPose:
    """Return a pose moved in its face's own frame."""
    cos, sin = np.cos(pose.yaw), np.sin(pose.yaw)
    x, y = pose.x + cos * depth + sin * right, pose.y + sin * depth - cos * right
    return LevelPose(float(x), float(y), pose.z + up, float(pose.yaw + np.radians(turn_deg)))


def slid(shot: Shot, pose: LevelPose, factor: float) -> LevelPose:
    """Return a pose moved along the camera's ray to so many times its distance."""
    center = shot.mounting.center
    x, y, z = center + factor * (pose.as_array()[:3] - center)
    return LevelPose(float(x), float(y), float(z), pose.yaw)


def blanked(shot: Shot, gray: int = 90) -> Shot:
    """Return a shot of one shade of gray from where another was taken."""
    return replace(shot, image=np.full_like(shot.image, gray))


def found(outcome: Outcome) -> Fit:
    """Return what was measured and accepted."""
    assert isinstance(outcome, Fit), outcome
    return outcome


def fit_of(outcome: Outcome) -> Fit:
    """Return what was measured, whether it was given up or not."""
    assert outcome.fit is not None, outcome
    return outcome.fit
