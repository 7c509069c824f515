"""The drive past a shelf: usable shots, whether the way triangulates, and the pallets and uprights along it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.drive import Drive, compose, evenly_spread, read_drive
from calibration.shelf.front_line import UPRIGHTS, FrontLine, pallet_line, upright_line
from calibration.shelf.level_view import LevelView, level_view
from calibration.shelf.pallets import PalletObservation, find_pallets, find_pallets_again
from calibration.shelf.plane import Foot, PlaneEstimate
from calibration.shelf.problem import DriveSolution, Observed, same_pallets, solve
from calibration.shelf.upright_edges import Edges, find_edges, measure_edges, triangulated
from palletloc.geometry import FloatArray, wrap_angle
from palletloc.io.images import ImageError
from palletloc.io.recording import Recording
from palletloc.shelf import ShelfPlane
from palletloc.trajectory import TrajectoryError

_MOST_SHOTS = 24
"""Shots that are used: more take time and tell little more."""
_LEAST_BASELINE = 0.2
"""Way along the shelf that triangulates, in parts of its distance."""
_LEAST_ACROSS = float(np.radians(15.0))
"""Angle between the way and the direction into the shelf below which things show no parallax, in radians."""
_NEAR_DEPTH, _FAR_DEPTH = 0.2, 0.6
"""How far uprights are looked for before and behind the plane, in metres: after pallets, and without them."""
_KNOWN_TURN, _ROUGH_TURN = float(np.radians(1.2)), float(np.radians(6.0))
"""How well the heading is known, in radians: after pallets, and without them."""
_BIASES = np.arange(-0.009, 0.0091, 0.001)
"""Biases of the gyroscope that are tried, in radians per second: a standard deviation of the odometry's."""
_ROUNDS = 3
"""How often uprights are found again by the poses that they give, where there are no pallets."""


@dataclass(frozen=True, slots=True, eq=False)
class Skipped:
    """A method that could not be used."""

    method: str
    """Its name."""
    code: str
    """Why, for programs."""
    what: str
    """Why, in one sentence."""


def usable_shots(recording: Recording) -> list[int]:
    """Return the indices of shots that odometry reaches and whose images can be read, evenly spread, at most 24."""
    reached = []
    for i, shot in enumerate(recording.shots):
        try:
            recording.odometry.pose_at(shot.time)
        except TrajectoryError:
            continue
        reached.append(i)
    spread = evenly_spread(len(reached), _MOST_SHOTS)
    return [reached[i] for i in spread if _readable(recording, reached[i])]


def _readable(recording: Recording, index: int) -> bool:
    try:
        recording.image(recording.shots[index], gray=True)
    except ImageError:
        return False
    return True


def motion_refusal(drive: Drive, camera: FloatArray, foot: Foot, prior: ShelfPlane) -> Skipped | None:
    """Return why the way does not allow to triangulate; None where it does."""
    poses = drive.poses()
    local = foot.local(compose(poses, np.tile([*camera, 0.0], (len(poses), 1)))[:, :2])
    along, deep = np.ptp(local, axis=0)
    distance = abs(foot.described(prior)[1])
    if len(poses) < 3:
        return Skipped(UPRIGHTS, "few_shots", f"{len(poses)} shots are too few to triangulate; three are needed")
    if deep > 0.05 and np.arctan2(along, deep) < _LEAST_ACROSS:
        return Skipped(UPRIGHTS, "along_the_ray", "the camera moves towards the shelf: what it sees has no parallax")
    if along < _LEAST_BASELINE * distance:
        what = f"the camera moves {along:.2f} m along a shelf {distance:.1f} m away; a fifth of that is needed"
        return Skipped(UPRIGHTS, "short_baseline", what)
    return None


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """The drive past landmarks, as far as it is known."""

    recording: Recording
    """With the stated mounting."""
    shots: tuple[int, ...]
    """Which of its shots are used."""
    prior: ShelfPlane
    """What was known before, in odom."""
    foot: Foot
    """What planes are described from."""
    observed: Observed
    """What poses and landmarks are based on."""
    solution: DriveSolution
    """Poses and landmarks."""
    edges: Edges
    """Upright edges."""
    line: FrontLine | None = None
    """The corners of uprights that form the front."""

    @property
    def pallets(self) -> PlaneEstimate | None:
        """The plane along the pallets."""
        return pallet_line(self.solution.pallets, self.solution.landmark_covariance()[0], self.foot)


def past_pallets(recording: Recording, prior: ShelfPlane, on_progress: Callable[[str], None]) -> Landmarks:
    """Return the drive past pallets: seen widely first, by a rough plane in odom, then by the poses that gives."""
    shots = tuple(usable_shots(recording))
    drive = read_drive(recording.odometry, [recording.shots[i].time for i in shots])
    sights, _ = find_pallets(recording, shots, prior, on_progress)
    found = _solved(recording, shots, prior, drive, sights)
    line = found.pallets
    if line is None:
        return found
    on_progress("localizing pallets once more")
    plane = replace(found.foot.plane(line.turn, line.distance), levels=prior.levels)
    again = _solved(recording, shots, prior, drive, find_pallets_again(recording, shots, found.solution.poses, plane))
    return found if len(again.observed.pallets) < len(found.observed.pallets) / 2 else again


def _solved(
    recording: Recording, shots: tuple[int, ...], prior: ShelfPlane, drive: Drive, sights: Sequence[PalletObservation]
) -> Landmarks:
    camera = np.asarray(recording.mounting.center[:2], dtype=np.float64)
    kept, owner = same_pallets(drive, sights)
    observed = Observed(drive, camera, tuple(kept), owner)
    solution = solve(observed)
    return Landmarks(recording, shots, prior, _foot(solution, camera, prior), observed, solution, Edges.none())


def _foot(solution: DriveSolution, camera: FloatArray, prior: ShelfPlane) -> Foot:
    """Return the camera's place at the middle of the way, with the heading that the pallets give."""
    middle = solution.poses[len(solution.poses) // 2]
    point = compose(middle, np.array([*camera, 0.0]))[:2]
    if not len(solution.pallets):
        return Foot(point, prior.yaw)
    turned = np.asarray(wrap_angle(solution.pallets[:, 2] - prior.yaw))
    foot = Foot(point, prior.yaw + float(np.median(turned)))
    line = pallet_line(solution.pallets, solution.landmark_covariance()[0], foot)
    return foot if line is None else Foot(point, foot.yaw + line.turn)


def past_uprights(found: Landmarks) -> Landmarks:
    """Return the drive past pallets, from `past_pallets`, and uprights; as it was where no upright edge is seen."""
    pallets, poses = found.pallets, found.solution.poses
    rough = found.foot.plane(pallets.turn, pallets.distance) if pallets else found.prior
    depth = _NEAR_DEPTH if pallets else _FAR_DEPTH
    views = _views(found, rough)
    if pallets is None:
        poses = _least_blurred(views, found.observed.drive, rough)
    turn_sigma = min(_KNOWN_TURN, 1.5 * pallets.sigma[0]) if pallets else _ROUGH_TURN
    solution = found.solution
    # Without pallets the first poses are rough: once more by the solved ones.
    for _ in range(1 if pallets else _ROUNDS):
        edges = find_edges(views, poses, rough, depth)
        edges, sights = triangulated(views, poses, edges, measure_edges(views, poses, edges, rough.yaw))
        if not len(edges.vote):
            return replace(found, solution=solution)
        observed = replace(found.observed, edges=tuple(sights))
        solution = solve(observed, edges.places)
        poses = solution.poses
    line = upright_line(edges, solution.edges, solution.landmark_covariance()[1], found.foot, turn_sigma)
    return replace(found, observed=observed, solution=solution, edges=edges, line=line)


def _views(found: Landmarks, rough: ShelfPlane) -> list[LevelView]:
    recording, distance = found.recording, max(found.foot.described(rough)[1], 0.3)
    views = []
    for index, pose in zip(found.shots, found.solution.poses, strict=True):
        image = recording.image(recording.shots[index], gray=True)
        towards = float(wrap_angle(rough.yaw - pose[2]))
        views.append(level_view(recording.camera, recording.mounting, image, towards, distance))
    return views


def _least_blurred(views: list[LevelView], drive: Drive, rough: ShelfPlane) -> FloatArray:
    """Return the poses, without the gyroscope's bias, at which most shots agree on upright edges."""
    tried = [drive.poses(bias=float(bias)) for bias in _BIASES]
    sharp = [float(np.sort(np.abs(find_edges(views, poses, rough, _FAR_DEPTH).vote))[-12:].sum()) for poses in tried]
    return tried[int(np.argmax(sharp))]
