"""The numbers of evo, where it is installed, on trajectories that are made here."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.evaluation.alignment import Alignment, align
from palletloc.evaluation.plane_projection import Plane, project
from palletloc.evaluation.pose_path import PosePath, associate
from palletloc.evaluation.step_pairs import pairs_by_count, pairs_by_distance
from palletloc.evaluation.trajectory_error import absolute_errors, distance_errors, relative_errors, statistics
from palletloc.geometry import FloatArray

metrics: Any = pytest.importorskip("evo.core.metrics")
sync: Any = pytest.importorskip("evo.core.sync")
trajectory: Any = pytest.importorskip("evo.core.trajectory")

CLOSE = 1e-9
PARTS = {
    "translation": metrics.PoseRelation.translation_part,
    "rotation": metrics.PoseRelation.rotation_angle_rad,
    "rotation_part": metrics.PoseRelation.rotation_part,
    "full": metrics.PoseRelation.full_transformation,
}
OF_EVO: dict[Alignment, dict[str, bool]] = {
    Alignment.NONE: {},
    Alignment.RIGID: {},
    Alignment.SIMILARITY: {"correct_scale": True},
}


def wandering(n: int = 240, seed: int = 5) -> tuple[PosePath, PosePath]:
    """Return a path through space and an estimate of it, in another frame, with noise and jitter in time."""
    rng = np.random.default_rng(seed)
    times = np.sort(rng.uniform(0, 12, n))
    s = times / 12
    positions = np.column_stack([6 * s, np.sin(5 * s), 0.4 * np.cos(7 * s)]) + rng.normal(scale=0.01, size=(n, 3))
    turns = Rotation.from_rotvec(np.column_stack([0.2 * np.sin(9 * s), 0.3 * s, 4 * s]))
    truth = RigidTransform.from_components(positions, turns)
    noise = RigidTransform.from_components(
        rng.normal(scale=0.03, size=(n, 3)), Rotation.from_rotvec(rng.normal(scale=0.02, size=(n, 3)))
    )
    elsewhere = RigidTransform.from_components([3.0, -2.0, 0.5], Rotation.from_rotvec([0.3, -0.2, 1.1]))
    off = elsewhere * truth * noise
    found = RigidTransform.from_components(1.03 * off.translation, off.rotation)
    return PosePath(times, truth), PosePath(times + rng.uniform(-0.002, 0.002, n).cumsum() * 0.05, found)


def as_evo(path: PosePath) -> Any:
    quaternions = path.poses.rotation.as_quat(scalar_first=True)
    return trajectory.PoseTrajectory3D(np.array(path.positions), np.array(quaternions), np.array(path.times))


def agree(ours: FloatArray, theirs: Any) -> None:
    np.testing.assert_allclose(ours, theirs.error, rtol=CLOSE, atol=CLOSE)
    known, found = theirs.get_all_statistics(), statistics(ours)
    for name, evos in {"minimum": "min", "maximum": "max"}.items():
        assert getattr(found, name) == pytest.approx(known[evos], rel=CLOSE, abs=CLOSE)
    for name in ("rmse", "mean", "median", "std", "sse"):
        assert getattr(found, name) == pytest.approx(known[name], rel=CLOSE, abs=CLOSE)


def aligned(method: Alignment) -> tuple[RigidTransform, RigidTransform, Any, Any]:
    reference, estimate = wandering()
    theirs, other = as_evo(reference), as_evo(estimate)
    if method is Alignment.ORIGIN:
        other.align_origin(theirs)
    elif method is not Alignment.NONE:
        other.align(theirs, **OF_EVO[method])
    return reference.poses, align(reference.poses, estimate.poses, method).estimate, theirs, other


@pytest.mark.parametrize("method", [method for method in Alignment if method is not Alignment.POSYAW])
@pytest.mark.parametrize("part", PARTS)
def test_absolute_errors(method: Alignment, part: str) -> None:
    reference, estimate, theirs, other = aligned(method)
    metric = metrics.APE(PARTS[part])
    metric.process_data((theirs, other))
    agree(getattr(absolute_errors(reference, estimate), part), metric)


@pytest.mark.parametrize("all_pairs", [False, True])
@pytest.mark.parametrize(("unit", "delta"), [("f", 1), ("f", 7), ("m", 0.5), ("m", 1.3)])
@pytest.mark.parametrize("part", PARTS)
def test_relative_errors(part: str, unit: str, delta: float, all_pairs: bool) -> None:
    reference, estimate, theirs, other = aligned(Alignment.NONE)
    by = metrics.Unit.frames if unit == "f" else metrics.Unit.meters
    metric = metrics.RPE(PARTS[part], delta, by, all_pairs=all_pairs)
    metric.process_data((theirs, other))
    if unit == "f":
        steps = pairs_by_count(len(estimate), int(delta), all_pairs=all_pairs)
    else:
        steps = pairs_by_distance(np.asarray(estimate.translation), delta, all_pairs=all_pairs)
    agree(getattr(relative_errors(reference, estimate, steps), part), metric)


def test_differences_of_distances() -> None:
    reference, estimate, theirs, other = aligned(Alignment.NONE)
    metric = metrics.RPE(metrics.PoseRelation.point_distance, 5, metrics.Unit.frames)
    metric.process_data((theirs, other))
    agree(distance_errors(reference, estimate, pairs_by_count(len(estimate), 5)), metric)


@pytest.mark.parametrize("plane", Plane)
def test_projections(plane: Plane) -> None:
    reference, estimate, theirs, other = aligned(Alignment.RIGID)
    theirs.project(trajectory.Plane(str(plane)))
    other.project(trajectory.Plane(str(plane)))
    metric = metrics.APE(metrics.PoseRelation.full_transformation)
    metric.process_data((theirs, other))
    agree(absolute_errors(project(reference, plane), project(estimate, plane)).full, metric)


@pytest.mark.parametrize(("kept", "offset"), [(slice(None, None, 3), 0.0), (slice(None), 0.004)])
@pytest.mark.parametrize("swapped", [False, True])
def test_association(kept: slice, offset: float, swapped: bool) -> None:
    first, second = wandering()
    second = PosePath(second.times[kept], second.poses[kept])
    if swapped:
        first, second = second, first
    theirs, other = sync.associate_trajectories(as_evo(first), as_evo(second), max_diff=0.01, offset_2=offset)
    ours = associate(first, second, 0.01, offset)
    np.testing.assert_allclose(ours.reference.translation, theirs.positions_xyz, atol=1e-12)
    np.testing.assert_allclose(ours.estimate.translation, other.positions_xyz, atol=1e-12)
