from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.choices import CameraKind, Side
from palletloc.geometry import LevelPose, level_pose
from palletloc.pallet_library import load_library
from palletloc.synthetic.aisle import AisleSpec
from palletloc.synthetic.loads import Load
from palletloc.synthetic.pallet_solid import PalletBody
from palletloc.synthetic.rig import Sensor
from palletloc.synthetic.simulation import (
    Approach,
    SimulatedOdometryNoise,
    SimulationSpec,
    measure_odometry,
    simulate,
)

AISLE = AisleSpec(models=(load_library()["epal1-1200"],), levels=(0.0,), length=5.0, opposite=False, clutter=0)
SPEC = SimulationSpec(aisle=AISLE, width=256, shots=2)
EXACT = replace(SPEC, odometry=SimulatedOdometryNoise(0.0, 0.0, 0.0, 0.0), plane_offset=0.0, plane_turn=0.0)


def test_the_same_seed_gives_the_same_bytes_in_any_order_and_another_one_another_recording() -> None:
    first, same, other = simulate(SPEC, 4), simulate(SPEC, 4), simulate(SPEC, 5)
    assert [first.image(shot).tobytes() for shot in (1, 0)] == [same.image(shot).tobytes() for shot in (1, 0)]
    assert simulate(SPEC, 4).image(0).tobytes() == first.image(0).tobytes()
    assert first.odometry.x.tobytes() == same.odometry.x.tobytes()
    assert (first.shelf, first.approach, first.aisle.pallets) == (same.shelf, same.approach, same.aisle.pallets)
    assert first.aisle.pallets != other.aisle.pallets
    assert first.shelf != other.shelf
    assert (first.image(0) != other.image(0)).mean() > 0.3


def test_the_sensor_leaves_scene_and_way_as_they_are() -> None:
    clean, noisy = simulate(SPEC, 4), simulate(replace(SPEC, sensor=Sensor(noise=20.0)), 4)
    assert (clean.aisle, clean.approach) == (noisy.aisle, noisy.approach)
    assert (clean.image(0) != noisy.image(0)).any()


def test_truth_and_perfect_odometry_agree() -> None:
    simulation = simulate(EXACT, 6)
    start = simulation.truth.pose_at(0.0).transform()
    for time in simulation.times.tolist():
        motion = level_pose(start.inv() * simulation.truth.pose_at(time).transform())
        assert simulation.odometry.pose_at(time).as_array() == pytest.approx(motion.as_array(), abs=5e-5)


@pytest.mark.parametrize("side", list(Side))
def test_an_exact_nominal_plane_passes_through_fronts_without_setback(side: Side) -> None:
    aisle = replace(AISLE, side=side, setback_sigma=0.0, yaw_sigma=0.0)
    simulation = simulate(replace(EXACT, aisle=aisle), 7)
    odom_from_world = simulation.truth.pose_at(0.0).transform().inv()
    shelf = simulation.shelf
    assert simulation.aisle.pallets
    for pallet in simulation.aisle.pallets:
        pose = level_pose(odom_from_world * pallet.world_from_pallet.transform())
        off = (pose.x - shelf.x) * np.cos(shelf.facing) + (pose.y - shelf.y) * np.sin(shelf.facing)
        assert off == pytest.approx(0.0, abs=1e-9)
        assert pose.yaw == pytest.approx(shelf.yaw, abs=1e-9)


def test_the_nominal_plane_is_off_within_its_limits() -> None:
    exact = [simulate(EXACT, seed).shelf for seed in range(20)]
    off = [simulate(replace(EXACT, plane_offset=0.03, plane_turn=0.014), seed).shelf for seed in range(20)]
    pairs = list(zip(exact, off, strict=True))
    turns = np.array([b.facing - a.facing for a, b in pairs])
    shifts = np.array([(b.x - a.x) * np.cos(a.facing) + (b.y - a.y) * np.sin(a.facing) for a, b in pairs])
    assert 0.007 < np.abs(turns).max() <= 0.014 + 1e-9
    assert 0.015 < np.abs(shifts).max() <= 0.03 + 1e-9


def test_a_mounting_with_errors_differs_from_the_true_one_by_them() -> None:
    assert simulate(SPEC, 1).recorded_mounting.as_matrix() == pytest.approx(
        simulate(SPEC, 1).forklift_from_camera.as_matrix()
    )
    spec = replace(SPEC, mounting_translation_sigma=0.01, mounting_rotation_sigma=0.002)
    shifts, turns = [], []
    for seed in range(30):
        simulation = simulate(spec, seed)
        error = simulation.forklift_from_camera.inv() * simulation.recorded_mounting
        shifts.append(error.translation)
        turns.append(error.rotation.as_rotvec())
    assert np.std(shifts) == pytest.approx(0.01, rel=0.2)
    assert np.std(turns) == pytest.approx(0.002, rel=0.2)


def test_true_poses_project_to_where_the_pallets_are_seen() -> None:
    aisle = replace(AISLE, loads=(Load.NONE,), filled=1.0)
    approach = Approach(LevelPose(-0.8, -0.3, 0.0, 0.1), length=2.0)
    mounting = RigidTransform.from_components([0.3, 0.1, 1.6], Rotation.from_euler("ZYX", [1.4, 0.1, -0.1]))
    spec = replace(SPEC, aisle=aisle, width=512, shots=3, approach=approach, mounting=mounting)
    simulation = simulate(spec, 8)
    bodies = [i for i, s in enumerate(simulation.aisle.scene.solids) if isinstance(s, PalletBody)]
    hits = []
    for shot, time in enumerate(simulation.times.tolist()):
        solids = simulation.picture(shot).solids
        world_from_camera = simulation.truth.pose_at(time).transform() * simulation.forklift_from_camera
        for body, pallet in zip(bodies, simulation.aisle.pallets, strict=True):
            camera_from_pallet = world_from_camera.inv() * pallet.world_from_pallet.transform()
            block = np.array([0.0, 0.0, 0.05])  # on the middle block, below the camera
            u, v = np.round(simulation.camera.project(camera_from_pallet.apply(block)).pixels).astype(int)
            hits.append(solids[v, u % 512] == body)
    assert len(hits) >= 6
    assert np.mean(hits) > 0.8  # an upright may stand before a block


@pytest.mark.parametrize("side", list(Side))
@pytest.mark.parametrize("kind", list(CameraKind))
def test_every_camera_sees_pallets_of_the_shelf(kind: CameraKind, side: Side) -> None:
    spec = replace(SPEC, camera=kind, width=160, shots=3, aisle=replace(AISLE, side=side, filled=1.0))
    simulation = simulate(spec, 2)
    solids = simulation.picture(1).solids
    fronts = [i for i, s in enumerate(simulation.aisle.scene.solids) if isinstance(s, PalletBody)]
    assert np.isin(solids, fronts).sum() > 20


def test_levels_may_be_kept_secret_or_be_off_while_the_pallets_stay() -> None:
    exact, off = simulate(SPEC, 1), simulate(replace(SPEC, level_sigma=0.003), 1)
    assert exact.shelf.levels == AISLE.levels
    assert simulate(replace(SPEC, tell_levels=False), 1).shelf.levels == ()
    assert exact.aisle.pallets == off.aisle.pallets
    assert replace(off.shelf, levels=()) == replace(exact.shelf, levels=())
    errors = [simulate(replace(SPEC, level_sigma=0.003), seed).shelf.levels[0] for seed in range(40)]
    assert np.std(errors) == pytest.approx(0.003, rel=0.25)


def test_no_shots_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one shot"):
        simulate(replace(SPEC, shots=0), 0)


WAY = Approach(LevelPose(-1.0, 0.2, 0.0, 0.4), length=3.0, speed=0.6, winding=0.05, wavelength=2.0, phase=0.7)


def test_the_heading_follows_the_way() -> None:
    x, y, yaw = WAY.poses(np.linspace(0.0, WAY.duration, 2001)).T
    assert np.arctan2(np.diff(y), np.diff(x)) == pytest.approx((yaw[1:] + yaw[:-1]) / 2, abs=1e-5)


def test_perfect_odometry_is_the_true_motion() -> None:
    odometry = measure_odometry(WAY, EXACT.odometry, np.random.default_rng(0))
    x, y, yaw = WAY.poses(np.zeros(1))[0].tolist()
    world_from_start = LevelPose(x, y, 0.0, yaw)
    for time in np.linspace(0.0, WAY.duration, 17).tolist():
        x, y, yaw = WAY.poses(np.array([time]))[0].tolist()
        truth = level_pose(world_from_start.transform().inv() * LevelPose(x, y, 0.0, yaw).transform())
        assert odometry.pose_at(time).as_array() == pytest.approx(truth.as_array(), abs=5e-5)


def test_rates_are_those_of_the_motion() -> None:
    odometry = measure_odometry(WAY, EXACT.odometry, np.random.default_rng(0))
    assert odometry.speed is not None
    assert odometry.yaw_rate is not None
    assert np.trapezoid(odometry.speed, odometry.times) == pytest.approx(
        np.hypot(np.diff(odometry.x), np.diff(odometry.y)).sum(), rel=1e-3
    )
    assert np.trapezoid(odometry.yaw_rate, odometry.times) == pytest.approx(odometry.yaw[-1], abs=5e-3)


def test_odometry_begins_at_zero_covers_the_approach_has_its_rate_and_drifts_by_its_seed() -> None:
    draws = [measure_odometry(WAY, SimulatedOdometryNoise(), np.random.default_rng(seed), 50.0) for seed in (1, 1, 2)]
    odometry, same, other = draws
    assert (odometry.x == same.x).all()
    assert (odometry.x != other.x).any()
    assert odometry.pose_at(0.0).as_array() == pytest.approx(np.zeros(4))
    assert np.diff(odometry.times) == pytest.approx(0.02)
    assert odometry.times[-1] >= WAY.duration


def test_errors_have_the_stated_spread() -> None:
    straight = Approach(length=4.0, speed=0.5, winding=0.0)
    scale, bias = SimulatedOdometryNoise(0.006, 0.0, 0.0, 0.0), SimulatedOdometryNoise(0.0, 0.004, 0.0, 0.0)
    ends = [measure_odometry(straight, scale, np.random.default_rng(i)).x[-1] for i in range(300)]
    assert np.std(ends) == pytest.approx(4.0 * 0.006, rel=0.12)
    turns = [measure_odometry(straight, bias, np.random.default_rng(i)).yaw[-1] for i in range(300)]
    assert np.std(turns) == pytest.approx(straight.duration * 0.004, rel=0.12)
