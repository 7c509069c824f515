from __future__ import annotations

import numpy as np
import pytest

from palletloc.geometry import LevelPose
from palletloc.measurement import PalletMeasurement, YawSource
from tracking import Odometry, PalletTracker, TrackerConfig
from tracking.config import MeasurementErrors


@pytest.mark.parametrize("inflation", [1.0, 1.4, 3.0])
def test_a_first_measurement_has_the_inflated_covariance(inflation: float) -> None:
    tracker = PalletTracker(TrackerConfig(errors=MeasurementErrors(inflation=inflation)))
    for time in (0.0, 0.1):
        tracker.push(Odometry(time, LevelPose(0.0, 0.0, 0.0, 0.0)))
    stated = np.diag([4e-5, 3e-5, 1e-5, 2e-5])
    there = LevelPose(2.0, 1.8, 0.0, 1.57)
    tracker.push(PalletMeasurement(0.1, "epal1-1200", there, stated, 0.9, YawSource.FACE))
    np.testing.assert_allclose(tracker.state(1).covariance, inflation * stated, rtol=1e-9, atol=1e-15)
