from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc import LevelPose, Mounting, PalletModel, load_library
from palletloc.edge_fit import EdgeFit
from palletloc.face import FaceEdge, edge_shift, face_lines
from palletloc.geometry import FloatArray
from palletloc.plane import PALLET_FROM_VERTICAL
from palletloc.refinement.depth_edges import DepthEdge, visible_depth_edges
from palletloc.refinement.edges import MeasuredEdge, SeenFace
from palletloc.refinement.normal_equations import DEPTH_ERROR, FaceEquations, FaceSolution, apparent_motion
from tests.palletloc.poses import Mounted

POSE = LevelPose(0.9, 2.0, 0.15, 1.7)
STEP = 1e-5
NONE = np.zeros(6)


@pytest.fixture
def mounting(mounted: Mounted) -> Mounting:
    return Mounting(mounted(0.3, -0.1, 1.8, 40.0, 5.0, -3.0))


def forklift_from_plane(pose: LevelPose) -> RigidTransform:
    return pose.transform() * PALLET_FROM_VERTICAL


def moved_face(pose: LevelPose, motion: FloatArray) -> LevelPose:
    """The pose after a motion in the face's own frame: right, up, depth, yaw."""
    right, up, depth, turn = motion
    x, y, z = forklift_from_plane(pose).apply(np.array([right, up, -depth]))
    return LevelPose(float(x), float(y), float(z), float(pose.yaw + turn))


def disturbed(mounting: Mounting, errors: FloatArray) -> RigidTransform:
    """The mounting moved along and turned about the forklift's axes."""
    true = mounting.forklift_from_camera
    turn = Rotation.from_rotvec(errors[3:]) * true.rotation
    return RigidTransform.from_components(true.translation + errors[:3], turn)


class Geometry:
    """Where points of the true face appear on the plane of the assumed one, by rays."""

    def __init__(self, assumed: Mounting, true_pose: LevelPose, errors: FloatArray) -> None:
        self.assumed = assumed
        self.face = forklift_from_plane(true_pose)
        # errors of the assumed mounting are opposite ones of the true one
        self.seeming = assumed.forklift_from_camera * disturbed(assumed, -errors).inv()
        self.plane_from_forklift = forklift_from_plane(POSE).inv()

    def image(self, point: Sequence[float] | FloatArray) -> FloatArray:
        in_forklift = self.seeming.apply(self.face.apply([*point, 0.0][:3]))
        camera = self.plane_from_forklift.apply(self.assumed.center)
        ray = self.plane_from_forklift.apply(in_forklift) - camera
        reached: FloatArray = (camera - ray * camera[2] / ray[2])[:2]
        return reached

    def fit(self, edge: FaceEdge) -> EdgeFit:
        start, end, middle = (np.array(p) for p in (edge.start, edge.end, edge.middle))
        moved = [(self.image(p) - p) @ edge.outward for p in (start, end)]
        offset = float((self.image(middle) - middle) @ edge.outward)
        return EdgeFit(offset, float(moved[1] - moved[0]) / edge.length, 1e-4, 1e-4, 1.0, 10.0)


def seen_face(
    model: PalletModel,
    mounting: Mounting,
    motion: FloatArray | None = None,
    errors: FloatArray = NONE,
    sigma: float = 1e-3,
    noise: Sequence[float] | FloatArray = (),
) -> SeenFace:
    true_pose = POSE if motion is None else moved_face(POSE, motion)
    geometry = Geometry(mounting, true_pose, errors)
    camera = forklift_from_plane(POSE).inv().apply(mounting.center)
    edges = []
    for i, line in enumerate(face_lines(model)):
        fit = geometry.fit(line.whole)
        fit = replace(fit, offset=fit.offset + (noise[i] if len(noise) else 0.0))
        shift = replace(edge_shift(line.whole, camera, model), sigma=0.0)
        edges.append(MeasuredEdge(line.whole, fit, sigma, shift, 0.003, 0.011, 1.0))
    return SeenFace(camera, np.eye(4), (), tuple(edges), len(edges))


def exact(mounting: Mounting) -> Mounting:
    return replace(mounting, translation_sigma=(0.0, 0.0, 0.0), rotation_sigma=(0.0, 0.0, 0.0))


def induced(mounting: Mounting, errors: FloatArray) -> FloatArray:
    """The motion that a level error of the mounting makes a pallet seem to make."""
    about = mounting.center
    point = np.array([POSE.x, POSE.y, POSE.z])
    turned = Rotation.from_rotvec(errors[3:]).apply(point - about) + about + errors[:3]
    right, up, nearer = forklift_from_plane(POSE).inv().apply(turned)
    return np.array([right, up, -nearer, errors[5]])


@pytest.mark.parametrize("unknown", range(4))
@pytest.mark.parametrize("slopes", [False, True])
def test_edges_tell_a_small_motion(unknown: int, slopes: bool, t11: PalletModel, mounting: Mounting) -> None:
    motion = STEP * np.eye(4)[unknown]
    system = FaceEquations(seen_face(t11, mounting, motion), POSE, mounting, t11)
    if slopes:
        system.add_slopes(0.1)
    np.testing.assert_allclose(system.solve().motion, motion, atol=0.02 * STEP)


def test_slopes_give_the_yaw_and_motions_add_up(t11: PalletModel, mounting: Mounting) -> None:
    motion = STEP * np.array([1.0, -2.0, 3.0, 1.5])
    seen = seen_face(t11, mounting, motion)
    solution = FaceEquations(seen, POSE, mounting, t11).solve()
    np.testing.assert_allclose(solution.motion, motion, atol=0.05 * STEP)
    np.testing.assert_allclose(solution.shifts, [edge.fit.offset for edge in seen.edges], atol=0.05 * STEP)
    assert solution.chi2 < 1.0
    np.testing.assert_allclose(solution.weights, 1.0, atol=1e-3)
    turn = STEP * np.array([0.0, 0.0, 0.0, 1.0])
    system = FaceEquations(seen_face(t11, mounting, turn, sigma=10.0), POSE, exact(mounting), t11)
    system.add_slopes(0.1)
    system.add_height(0.0, 1e-3)
    assert system.solve().motion[3] == pytest.approx(STEP, rel=0.02)


def test_points_seem_to_move_as_they_do_with_a_wrong_mounting(mounting: Mounting) -> None:
    points = np.random.default_rng(0).uniform(-4.0, 4.0, (20, 3))
    points_camera = mounting.forklift_from_camera.inv().apply(points)
    motion = apparent_motion(points, mounting.center)
    assert motion.shape == (20, 3, 6)
    for k, errors in enumerate(STEP * np.eye(6)):
        moved = disturbed(mounting, errors).apply(points_camera) - disturbed(mounting, -errors).apply(points_camera)
        np.testing.assert_allclose(motion[:, :, k], moved / (2 * STEP), atol=1e-6)
    # turns leave the camera itself where it is
    at_camera = apparent_motion(mounting.center[None], mounting.center)
    np.testing.assert_allclose(at_camera[0], np.eye(3, 6), atol=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2, 5], ids=["x", "y", "z", "yaw"])
def test_wrong_mountings_move_it_as_covariances_say(axis: int, t11: PalletModel, mounting: Mounting) -> None:
    errors = STEP * np.eye(6)[axis]
    solution = FaceEquations(seen_face(t11, mounting, errors=errors), POSE, exact(mounting), t11).solve()
    np.testing.assert_allclose(solution.motion, induced(mounting, errors), atol=0.05 * STEP)
    sigma = 0.002 * np.eye(6)[axis]
    uncertain = Mounting(mounting.forklift_from_camera, tuple(sigma[:3]), tuple(sigma[3:]))
    solution = FaceEquations(seen_face(t11, mounting, sigma=1e-7), POSE, uncertain, t11).solve()
    motion = induced(mounting, 1e-6 * np.eye(6)[axis]) / 1e-6 * 0.002
    np.testing.assert_allclose(solution.covariance, np.outer(motion, motion), rtol=1e-2, atol=1e-9)


@pytest.mark.parametrize("axis", [3, 4], ids=["roll", "pitch"])
def test_a_tilted_mounting_makes_the_place_uncertain(axis: int, t11: PalletModel, mounting: Mounting) -> None:
    sigma = 0.003 * np.eye(6)[axis]
    tilted = Mounting(mounting.forklift_from_camera, (0.0, 0.0, 0.0), tuple(sigma[3:]))
    sure, unsure = (FaceEquations(seen_face(t11, mounting), POSE, each, t11) for each in (exact(mounting), tilted))
    for system in (sure, unsure):
        system.add_height(0.0, 0.001)
    gained = unsure.solve().covariance - sure.solve().covariance
    assert np.linalg.eigvalsh(gained).min() > -1e-9
    assert np.sqrt(np.trace(gained[:3, :3])) > 0.002


def test_a_known_height_pulls_the_depth_as_the_camera_looks_down(t11: PalletModel, mounting: Mounting) -> None:
    vague = seen_face(t11, mounting, sigma=1e-3)
    system = FaceEquations(vague, POSE, exact(mounting), t11)
    system.add_height(0.010, 1e-6)
    right, up, depth, _ = system.solve().motion
    camera = vague.plane_from_camera
    middle = t11.height / 2
    assert up == pytest.approx(0.010, abs=1e-5)
    # what lies higher on the same viewing ray is nearer to the camera, which is above
    assert depth == pytest.approx(-0.010 * camera[2] / (camera[1] - middle), rel=0.15)
    assert np.sign(right) == np.sign(camera[0])


@pytest.mark.parametrize(("name", "unknown"), [("height", 1), ("turn", 3), ("yaw", 3)])
def test_priors_rule_where_edges_say_little(name: str, unknown: int, t11: PalletModel, mounting: Mounting) -> None:
    system = FaceEquations(seen_face(t11, mounting, sigma=10.0), POSE, exact(mounting), t11)
    if name == "height":
        system.add_height(0.004, 0.002)
    elif name == "turn":
        system.add_turn(0.004, 0.002)
    else:
        system.add_yaw(0.004, 0.002, 0.0)
    solution = system.solve()
    assert solution.motion[unknown] == pytest.approx(0.004, rel=1e-2)
    assert np.sqrt(solution.covariance[unknown, unknown]) == pytest.approx(0.002, rel=1e-2)


def test_a_lines_yaw_shares_a_mountings_error_and_a_known_turn_does_not(t11: PalletModel, mounting: Mounting) -> None:
    turned = Mounting(mounting.forklift_from_camera, (0.0, 0.0, 0.0), (0.0, 0.0, 0.005))
    sigmas = []
    for add in ("add_yaw", "add_turn"):
        system = FaceEquations(seen_face(t11, mounting, sigma=10.0), POSE, turned, t11)
        getattr(system, add)(0.0, 1e-5, *((0.0,) if add == "add_yaw" else ()))
        sigmas.append(float(np.sqrt(system.solve().covariance[3, 3])))
    assert sigmas[0] == pytest.approx(0.005, rel=1e-2)
    assert sigmas[1] < 1e-4


def test_an_odd_edge_loses_weight_and_scatter_widens_the_covariance(t11: PalletModel, mounting: Mounting) -> None:
    count = len(face_lines(t11))
    for wrong in range(count):
        noise = 0.030 * np.eye(count)[wrong]
        system = FaceEquations(seen_face(t11, mounting, noise=noise), POSE, mounting, t11)
        system.add_height(0.0, 0.003)
        system.add_turn(0.0, 0.001)
        solution = system.solve()
        assert solution.weights[wrong] < 0.1
        assert np.delete(solution.weights, wrong).min() > 0.5
        assert np.abs(solution.motion).max() < 0.002
    noise = np.random.default_rng(0).normal(0.0, 0.004, len(face_lines(t11)))
    calm, torn = (FaceEquations(seen_face(t11, mounting, noise=n), POSE, exact(mounting), t11) for n in ((), noise))
    quiet, loud = calm.solve(), torn.solve()
    assert loud.chi2 > 2.0 > quiet.chi2
    assert (np.diag(loud.covariance) > 2.0 * np.diag(quiet.covariance)).all()


def test_a_covariance_is_symmetric_and_positive_definite(model: PalletModel, mounting: Mounting) -> None:
    system = FaceEquations(seen_face(model, mounting), POSE, mounting, model)
    system.add_slopes(0.1)
    covariance = system.solve().covariance
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9, atol=1e-15)
    assert np.linalg.eigvalsh(covariance).min() > 0


# Edges behind the face.

EPAL = load_library()["epal1-1200"]
LEVEL_POSE = replace(POSE, z=1.72)


def level_system(mounting: Mounting, sigma: float = 1e-3) -> tuple[FaceEquations, FaceSolution, list[DepthEdge]]:
    """A face at the camera's height, its solution, and the edges behind it."""
    camera = forklift_from_plane(LEVEL_POSE).inv().apply(mounting.center)
    fit = EdgeFit(0.0, 0.0, 1e-4, 1e-4, 1.0, 10.0)
    edges = [
        MeasuredEdge(line.whole, fit, sigma, edge_shift(line.whole, camera, EPAL), 0.003, 0.011, 1.0)
        for line in face_lines(EPAL)
    ]
    system = FaceEquations(SeenFace(camera, np.eye(4), (), tuple(edges), len(edges)), LEVEL_POSE, mounting, EPAL)
    system.add_height(0.0, 0.003)
    system.add_turn(0.0, 0.1)
    behind = list(visible_depth_edges(EPAL, camera))
    assert len(behind) > 4
    return system, system.solve(), behind


def motion_of(system: FaceEquations, behind: list[DepthEdge]) -> FloatArray:
    return system.motion_behind(np.array([edge.place for edge in behind]), [edge.level for edge in behind])


@pytest.mark.parametrize("unknown", range(10))
def test_edges_behind_the_face_are_expected_where_geometry_puts_them(unknown: int, mounting: Mounting) -> None:
    system, _, behind = level_system(mounting)
    motion, errors = np.split(STEP * np.eye(10)[unknown], [4])
    x, y, z = forklift_from_plane(LEVEL_POSE).apply(motion[:3] * [1, 1, -1])
    true_pose = LevelPose(x, y, z, LEVEL_POSE.yaw + motion[3])
    seeming = mounting.forklift_from_camera * disturbed(mounting, -errors).inv()
    plane_from_forklift = forklift_from_plane(LEVEL_POSE).inv()
    camera = plane_from_forklift.apply(mounting.center)
    moved = [
        plane_from_forklift.apply(seeming.apply(forklift_from_plane(true_pose).apply(edge.place))) for edge in behind
    ]
    right = [camera[0] + (p[0] - camera[0]) * camera[2] / (camera[2] - p[2]) for p in moved]
    expected = np.array(right) - [edge.image.middle[0] for edge in behind]
    found = STEP * motion_of(system, behind)[:, unknown]
    np.testing.assert_allclose(found, expected, atol=2e-3 * STEP + 1e-9)
    assert np.abs(found).max() > 0.1 * STEP or unknown in (1, 6, 7, 8)


def test_edges_of_one_depth_share_its_error(mounting: Mounting) -> None:
    system, solution, behind = level_system(mounting)
    camera = system.seen.plane_from_camera
    first = len(solution.unknowns) - 5
    for level in range(5):
        for edge, offset in zip(behind, STEP * motion_of(system, behind)[:, first + level], strict=True):
            right, _, near = edge.place
            deeper = camera[0] + (right - camera[0]) * camera[2] / (camera[2] - near + DEPTH_ERROR * STEP)
            expected = deeper - edge.image.middle[0] if edge.level == level else 0.0
            assert offset == pytest.approx(expected, abs=1e-10)


def test_what_is_measured_behind_the_face_turns_it_as_far_as_its_depth_is_known(mounting: Mounting) -> None:
    system, solution, behind = level_system(exact(mounting), sigma=0.01)
    motion = motion_of(system, behind)
    offsets = 0.01 * motion[:, 3]
    system.add_offset(offsets / (offsets @ offsets) @ motion, 1.0, 0.01)
    better = system.solve()
    assert better.motion[3] == pytest.approx(0.01, rel=0.2)
    assert better.covariance[3, 3] < 0.1 * solution.covariance[3, 3]
    system, solution, behind = level_system(exact(mounting), sigma=0.01)
    rear = [edge for edge in behind if edge.level == 4]
    mean = motion_of(system, rear).mean(axis=0)
    system.add_offset(mean, 0.0, 1e-7)
    by_yaw, by_depth = mean[3], mean[-1]
    yaw_sigma = float(np.sqrt(system.solve().covariance[3, 3]))
    assert yaw_sigma < float(np.sqrt(solution.covariance[3, 3]))
    assert yaw_sigma > 0.5 * abs(by_depth / by_yaw)


def test_level_with_the_camera_blur_makes_the_range_less_certain(mounting: Mounting) -> None:
    sharp, blurred = (
        [replace(edge, pixel=pixel) for edge in level_system(mounting)[0].seen.edges] for pixel in (1e-6, 0.006)
    )
    depths = []
    for pose in (LEVEL_POSE, POSE):
        camera = forklift_from_plane(pose).inv().apply(mounting.center)
        seen = [SeenFace(camera, np.eye(4), (), tuple(edges), len(edges)) for edges in (sharp, blurred)]
        systems = [FaceEquations(face, pose, exact(mounting), EPAL) for face in seen]
        depths.append([float(np.sqrt(system.solve().covariance[2, 2])) for system in systems])
    assert depths[0][1] > 1.3 * depths[0][0]
    assert depths[1][1] == pytest.approx(depths[1][0])
