from __future__ import annotations

import numpy as np

from benchmarks.run_parts import between
from palletloc.evaluation.pose_error import PalletEstimate, TrueFace
from palletloc.evaluation.run_match import match_shot
from palletloc.geometry import LevelPose


def test_parts_by_height_hold_each_pallet_once() -> None:
    places = [LevelPose(2.0 * i, 2, z, 0) for i, z in enumerate((0.0, 1.2, 1.55, 2.4))]
    faces = [TrueFace(str(i), "t11", pose, 2.0, 1.8 - pose.z, True) for i, pose in enumerate(places)]
    found = [LevelPose(2.0 * i, 2 + 0.6 * (i == 1), z, 0) for i, z in enumerate((0.0, 1.2, 1.55))]
    shot = match_shot(0.0, [PalletEstimate(0.0, "t11", pose, np.eye(4)) for pose in found], faces)
    low, high = between(shot, 0.6, np.inf, 1.8), between(shot, -np.inf, 0.6, 1.8)
    assert [error.face.id for error in low.errors] == ["0"]
    assert [face.id for face in low.missed] == ["1"]
    assert [error.face.id for error in high.errors] == ["2"]
    assert [face.id for face in high.missed] == ["3"]
    assert (len(low.false), len(high.false)) == (1, 0)
