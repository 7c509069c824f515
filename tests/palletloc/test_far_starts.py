from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from palletloc.geometry import LevelPose
from palletloc.localizer import Localizer, Start
from palletloc.pallet import PalletModel
from palletloc.shot import Shot

Placed = tuple[PalletModel, LevelPose]


@pytest.mark.parametrize("index", [0, 1])
@pytest.mark.parametrize("along_ray", [-0.25, 0.45])
def test_a_start_far_off_along_the_viewing_ray_leads_to_the_pallet(
    along_ray: float,
    index: int,
    floor_localizer: Callable[..., Localizer],
    floor_shot: Shot,
    floor_pallets: tuple[Placed, ...],
) -> None:
    model, pose = floor_pallets[index]
    center = floor_shot.mounting.center
    ray = pose.as_array()[:3] - center
    x, y, _ = center + ray * (1 + along_ray / np.linalg.norm(ray))
    start = replace(pose, x=float(x), y=float(y), yaw=pose.yaw + np.radians(2.0))
    (found,) = floor_localizer().localize_from(floor_shot, [Start(model.name, start)], (0.0,))
    assert found is not None
    error = np.abs(found.forklift_from_pallet.as_array() - pose.as_array())
    assert error[:3].max() < 0.03
    assert error[3] < np.radians(1.0)
