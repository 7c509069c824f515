"""A small aisle with two pallets and a path past them, for tests of runs over it."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.evaluation.pose_error import PalletEstimate, Visibility
from palletloc.evaluation.run_match import TrueScene
from palletloc.geometry import LevelPose, level_pose
from palletloc.io.truth import TruePallet
from palletloc.trajectory import Trajectory

TIMES = [0.0, 1.0, 2.0, 3.0]
"""Of the shots, in seconds."""
PATH = Trajectory(*np.array([TIMES, [0.0, 0.5, 1.0, 1.5], [0.0] * 4, [0.0] * 4]))


PALLETS = (
    TruePallet("A", "t11", LevelPose(2.0, 1.8, 0.1, np.pi / 2)),
    TruePallet("B", "t11", LevelPose(3.5, 1.8, 0.1, np.pi / 2)),
)
SCENE = TrueScene(
    PATH, PALLETS, {"t11": 1.1}, RigidTransform.from_translation([0.3, 0, 1.8]), Visibility(max_range=9.0)
)


def estimate(time: float, place: TruePallet, off: float = 0.0, track: str = "", yaw: float = 0.0) -> PalletEstimate:
    """Return what a run says of a pallet, ``off`` metres too deep."""
    true = PATH.pose_at(time).transform().inv() * place.world_from_pallet.transform()
    pose = level_pose(true * LevelPose(off, 0, 0, yaw).transform())
    return PalletEstimate(time, "t11", pose, 1e-4 * np.eye(4), track)


def false_one(time: float, track: str = "") -> PalletEstimate:
    return PalletEstimate(time, "t11", LevelPose(-5.0, -5.0, 0.0, 0.0), np.eye(4), track)


def everything(off: float = 0.0) -> list[PalletEstimate]:
    return [estimate(time, place, off, place.id) for time in TIMES for place in PALLETS]
