from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc.cameras import Equirectangular
from palletloc.geometry import LevelPose, level_pose
from palletloc.io.recording import Recording, Shot
from palletloc.io.truth import TruePallet, Truth
from palletloc.measurement import PalletMeasurement, YawSource
from palletloc.pallet import PalletModel
from palletloc.report.comparison import compare
from palletloc.report.error_figure import error_figure
from palletloc.shelf import ShelfPlane
from palletloc.trajectory import Trajectory

TIMES = (0.0, 1.0)
FORKLIFT = Trajectory(np.array(TIMES), np.array([1.0, 1.5]), np.array([0.2, 0.2]), np.array([0.3, 0.3]))
PALLET = TruePallet("A", "t11", LevelPose(3.0, 2.5, 0.1, 1.7))
SIGMA = np.array([0.004, 0.009, 0.002, 0.003])


@pytest.fixture
def recording(t11: PalletModel) -> Recording:
    mounting = RigidTransform.from_translation([0.3, 0.0, 1.8])
    shots = tuple(Shot(time, f"{time}.jpg") for time in TIMES)
    shelf = ShelfPlane(3.0, 2.0, -1.5)
    return Recording(Path(), Equirectangular(64, 32), mounting, shelf, (t11,), shots, FORKLIFT)


def measurement(time: float, depth: float, along: float, height: float, yaw: float) -> PalletMeasurement:
    """Return a measurement whose error and sigmas are known in the pallet's own directions."""
    forklift_from_pallet = FORKLIFT.pose_at(time).transform().inv() * PALLET.world_from_pallet.transform()
    moved = level_pose(forklift_from_pallet * LevelPose(depth, along, height, yaw).transform())
    true_yaw = level_pose(forklift_from_pallet).yaw
    cos, sin = np.cos(true_yaw), np.sin(true_yaw)
    axes = np.array([[cos, -sin, 0, 0], [sin, cos, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    covariance = axes @ np.diag(SIGMA**2) @ axes.T
    return PalletMeasurement(time, "t11", moved, covariance, 0.8, YawSource.BOTTOM, f"{time}.jpg")


def test_errors_and_sigmas_are_in_the_pallets_directions(recording: Recording) -> None:
    measured = measurement(0.0, 0.012, -0.007, 0.003, 0.004)
    (error,) = compare(recording, Truth(FORKLIFT, (PALLET,)), [measured]).errors
    assert error.offset == pytest.approx([0.012, -0.007, 0.003, 0.004])
    assert error.sigma == pytest.approx(SIGMA)
    assert error.is_covered.tolist() == [False, True, True, True]


def test_a_pallet_is_found_once_and_every_other_measurement_is_false(recording: Recording) -> None:
    good, worse = measurement(0.0, 0.01, 0.0, 0.0, 0.0), measurement(0.0, 0.03, 0.0, 0.0, 0.0)
    far = measurement(0.0, 0.0, 0.9, 0.0, 0.0)
    result = compare(recording, Truth(FORKLIFT, (PALLET,)), [worse, far, good])
    assert [one.measured for one in result.errors] == [good]
    assert list(result.unmatched) == [worse, far]
    assert (result.found, len(result.missed)) == (1, 1)  # the second shot found nothing


def test_a_shot_without_measurements_misses_its_pallets(recording: Recording) -> None:
    result = compare(recording, Truth(FORKLIFT, (PALLET,)), [])
    assert (result.found, len(result.missed), result.errors) == (0, 2, ())


def test_a_pallet_out_of_range_is_not_missed(recording: Recording) -> None:
    away = replace(PALLET, world_from_pallet=LevelPose(9.0, 2.5, 0.1, 1.7))
    assert compare(recording, Truth(FORKLIFT, (away,)), []).missed == ()


def test_the_chart_has_a_point_for_each_measurement_and_quantity(recording: Recording) -> None:
    errors = compare(
        recording, Truth(FORKLIFT, (PALLET,)), [measurement(time, 0.01, 0.0, 0.0, 0.002) for time in TIMES]
    ).errors
    figure = error_figure(errors)
    yaw, depth = figure.axes
    (yaw_points,), (depth_points,) = (
        [line for line in axes.lines if line.get_marker() == "o"] for axes in (yaw, depth)
    )
    assert yaw_points.get_ydata() == pytest.approx(np.degrees([0.002, 0.002]))
    assert depth_points.get_ydata() == pytest.approx([10.0, 10.0])
    assert yaw.get_ylim()[1] > np.degrees(0.002)
