r"""By how much everything is seen turned about the upright axis, as a drive past standing pallets tells.

A camera that is turned against its stated mounting by :math:`-\delta` puts a pallet at :math:`R(\delta) (q - c) + c`
in place of q, with c the camera's place, and adds :math:`\delta` to its yaw. Of a pallet that stands that is the same
from everywhere only if :math:`\delta = 0`: over a way d it drifts aside by :math:`d \sin\delta`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.planar import compose, quarter, relative, relative_slopes, turned
from palletloc.trajectory import Trajectory, TrajectoryError

IntArray = NDArray[np.intp]
"""Numbers of shots and pallets."""
_SURE, _LEAST_DEG = 3.0, 0.5
"""Standard deviations, and degrees, from which on a turn is told, as of `palletloc calibrate check`."""
_VAGUE_DEG = 1.0
"""Standard deviation above which a drive tells nothing, in degrees."""
_SAME_M, _SAME_RAD, _SAME_LEVEL = 0.45, 0.35, 0.4
"""How far a pallet may seem to move from one shot to the next, aside, in yaw and in height: less than to its
neighbour."""
_MOST_SHOTS, _MOST_PALLETS = 30, 8
"""How many shots and pallets are fitted at most: more tell little more, and the cost grows with their third power."""
_LEAST_SHOTS = 3
"""In how many shots a pallet has to be seen."""
_FLOOR = np.ix_((0, 1, 3), (0, 1, 3))
"""Rows and columns of x, y and yaw in a covariance."""
_HUBER = 2.8
"""Length of a sighting's residual up to which it counts in full: 95 % are shorter (chi-square of 3)."""
_ROUNDS, _SMALL_STEP = 20, 1e-6
"""Rounds of the fit at most, and the step that ends it, in metres and radians."""


class PalletSighting(Protocol):
    """A pallet that was measured in a shot."""

    @property
    def time(self) -> float:
        """Of the shot, in seconds."""

    @property
    def model(self) -> str:
        """Name of the pallet model."""

    @property
    def forklift_from_pallet(self) -> LevelPose:
        """Its pose."""

    @property
    def covariance(self) -> FloatArray:
        """(4, 4) covariance of (x, y, z, yaw)."""


@dataclass(frozen=True, slots=True)
class OdometryDoubt:
    """How far odometry may be off; one standard deviation each."""

    scale: float = 0.015
    """Relative error of all distances."""
    bias: float = 0.0035
    """Constant error of the yaw rate, in radians per second."""
    place: float = 0.004
    """Random error of the place after one second, in metres; grows with the root of the time."""
    heading: float = 0.0017
    """Random error of the heading after one second, in radians; grows with the root of the time."""
    slip: float = 0.003
    """Random error of a step as a part of the root of its length in metres."""
    line: float = 0.0017
    """Angle between the line of travel and the forklift's x axis, in radians: it looks like a turn of the camera."""


@dataclass(frozen=True, slots=True)
class SeenTurn:
    """By how much everything is seen turned to the left."""

    angle: float
    """In radians: the stated yaw of the mounting minus the true one."""
    sigma: float
    """Its standard deviation."""
    stated_yaw: float
    """The yaw of the stated mounting, in radians."""
    pallets: int
    """How many pallets tell it."""
    shots: int
    """In how many shots."""

    @property
    def is_told(self) -> bool:
        """Whether it is large, and sure, enough to be told."""
        return abs(self.angle) > max(_SURE * self.sigma, math.radians(_LEAST_DEG))

    @property
    def line(self) -> str:
        """What to say of it."""
        turn, sigma = math.degrees(self.angle), math.degrees(self.sigma)
        fitting = math.degrees(self.stated_yaw) - turn
        what = f"the camera is turned by {-turn:+.2f} degrees of yaw against forklift_from_camera (sigma {sigma:.2f})"
        why = f"{self.pallets} pallets that stand seem to move aside over {self.shots} shots"
        return f"{what}: {why}; a yaw of {fitting:.2f} degrees fits; see palletloc calibrate check"


def seen_turn(
    sightings: Iterable[PalletSighting],
    odometry: Trajectory,
    forklift_from_camera: RigidTransform,
    doubt: OdometryDoubt | None = None,
) -> SeenTurn | None:
    """Return by how much everything is seen turned, from pallets that stand while the forklift drives.

    Poses at the shots, places of the pallets, errors of the odometry and the turn are fitted together, by least
    squares with Huber's loss.

    Parameters
    ----------
    sightings : iterable of PalletSighting
        Measured with the stated mounting, in any order.
    odometry : Trajectory
        ``odom_from_forklift``.
    forklift_from_camera : RigidTransform
        The stated mounting.
    doubt : OdometryDoubt, optional
        How far the odometry may be off.

    Returns
    -------
    SeenTurn or None
        None where the drive does not tell it within a degree.
    """
    drive = _drive_of(tuple(sightings), odometry, forklift_from_camera.translation[:2], doubt or OdometryDoubt())
    if drive is None:
        return None
    yaw = float(forklift_from_camera.rotation.as_euler("ZYX")[0])
    return _fitted(drive, yaw)


def turn_lines(turn: SeenTurn | None) -> tuple[str, ...]:
    """Return the line about a turn that is to be told; none where there is none."""
    return (turn.line,) if turn is not None and turn.is_told else ()


def turn_document(turn: SeenTurn | None) -> dict[str, float | None]:
    """Return the same in plain values, whether it is to be told or not: how far the camera is turned to the left."""
    if turn is None:
        return {"mounting_yaw_off_deg": None, "mounting_yaw_sigma_deg": None}
    return {
        "mounting_yaw_off_deg": -math.degrees(turn.angle),
        "mounting_yaw_sigma_deg": math.degrees(turn.sigma),
    }


@dataclass(frozen=True, slots=True, eq=False)
class _Drive:
    """A drive with what was seen in it: k shots, j pallets, m sightings."""

    poses: FloatArray
    """(k, 3) odometry at the shots."""
    durations: FloatArray
    """(k - 1,) from shot to shot, in seconds."""
    shot: IntArray
    """(m,) in which shot it was."""
    pallet: IntArray
    """(m,) which pallet it was."""
    measured: FloatArray
    """(m, 3) x, y and yaw in the forklift frame."""
    whitening: FloatArray
    """(m, 3, 3) makes their errors independent, of unit variance."""
    center: FloatArray
    """(2,) the camera's place."""
    doubt: OdometryDoubt
    """How far the odometry may be off."""


def _drive_of(
    sightings: Sequence[PalletSighting], odometry: Trajectory, center: FloatArray, doubt: OdometryDoubt
) -> _Drive | None:
    """Return the drive with the pallets that are seen most; None where too little is seen."""
    known: dict[float, LevelPose] = {}
    for time in sorted({sighting.time for sighting in sightings}):
        try:
            known[time] = odometry.pose_at(time)
        except TrajectoryError:
            continue
    usable = (each for each in sightings if each.time in known and _is_sound(each))
    seen = sorted(usable, key=lambda each: each.time)
    chains = sorted(_chains(seen, known), key=len, reverse=True)[:_MOST_PALLETS]
    chains = [chain for chain in chains if len(chain) >= _LEAST_SHOTS]
    times = sorted({each.time for chain in chains for each in chain})
    if len(times) < _LEAST_SHOTS:
        return None
    kept = np.unique(np.linspace(0, len(times) - 1, min(len(times), _MOST_SHOTS)).round().astype(np.intp))
    numbers = {times[i]: number for number, i in enumerate(kept.tolist())}
    found = [
        (numbers[each.time], j, each) for j, chain in enumerate(chains) for each in chain if each.time in numbers
    ]
    return _Drive(
        np.array([_planar(known[time]) for time in numbers]),
        np.diff(list(numbers)),
        np.array([shot for shot, _, _ in found]),
        np.array([pallet for _, pallet, _ in found]),
        np.array([_planar(each.forklift_from_pallet) for _, _, each in found]),
        np.linalg.inv(np.linalg.cholesky(np.array([each.covariance[_FLOOR] for _, _, each in found]))),
        center,
        doubt,
    )


def _is_sound(each: PalletSighting) -> bool:
    """Tell whether its covariance is one."""
    covariance = each.covariance[_FLOOR]
    return bool(np.isfinite(covariance).all() and np.linalg.eigvalsh(covariance)[0] > 0)


def _planar(pose: LevelPose) -> tuple[float, float, float]:
    return pose.x, pose.y, pose.yaw


def _chains(seen: Sequence[PalletSighting], known: dict[float, LevelPose]) -> list[list[PalletSighting]]:
    """Return the sightings of each pallet: each is near the last one, carried by odometry."""
    chains: list[list[PalletSighting]] = []
    places: list[FloatArray] = []
    for each in seen:
        place = compose(np.array(_planar(known[each.time])), np.array(_planar(each.forklift_from_pallet)))
        possible = {
            i: float(np.hypot(*(place - places[i])[:2]))
            for i, chain in enumerate(chains)
            if _may_follow(each, chain[-1]) and abs(wrap_angle(place[2] - places[i][2])) < _SAME_RAD
        }
        nearest = min(possible, key=possible.__getitem__, default=None)
        if nearest is None or possible[nearest] > _SAME_M:
            chains.append([each])
            places.append(place)
        else:
            chains[nearest].append(each)
            places[nearest] = place
    return chains


def _may_follow(each: PalletSighting, last: PalletSighting) -> bool:
    return (
        each.model == last.model
        and each.time > last.time
        and abs(each.forklift_from_pallet.z - last.forklift_from_pallet.z) < _SAME_LEVEL
    )


def _fitted(drive: _Drive, stated_yaw: float) -> SeenTurn | None:
    """Fit a drive: unknown are the poses after the first, the pallets, the turn, and the odometry's two constants."""
    shots, pallets = len(drive.poses), int(drive.pallet.max()) + 1
    first = np.array([np.flatnonzero(drive.pallet == j)[0] for j in range(pallets)])
    places = compose(drive.poses[drive.shot[first]], drive.measured[first])
    state = np.concatenate([drive.poses.ravel(), places.ravel(), np.zeros(3)])
    odometry, sightings = 3 * shots - 1, slice(3 * shots - 1, None)
    for _ in range(_ROUNDS):
        residuals, slopes = _linearized(state, drive)
        sizes = np.linalg.norm(residuals[sightings].reshape(-1, 3), axis=1)
        weights = np.concatenate([np.ones(odometry), np.repeat(_HUBER / np.maximum(sizes, _HUBER), 3)])
        weighted = slopes[:, 3:].T * weights  # the first pose stays
        normal = weighted @ slopes[:, 3:]
        try:
            step = np.linalg.solve(normal, -weighted @ residuals)
        except np.linalg.LinAlgError:
            return None
        state[3:] += step
        if np.abs(step).max() < _SMALL_STEP:
            break
    free = max(3 * len(drive.shot) - 3 * pallets - 3, 1)
    excess = max(1.0, float(np.minimum(sizes**2, _HUBER * sizes).sum()) / free)
    sigma = math.sqrt(float(np.linalg.inv(normal)[-3, -3]) * excess + drive.doubt.line**2)
    if sigma > math.radians(_VAGUE_DEG):
        return None
    return SeenTurn(float(state[-3]), sigma, stated_yaw, pallets, shots)


def _linearized(state: FloatArray, drive: _Drive) -> tuple[FloatArray, FloatArray]:
    """Return what odometry and sightings contradict of a state, in standard deviations, and the derivative by it.

    Three rows for each step, one for each constant of the odometry, three for each sighting.
    """
    shots, doubt, columns = len(drive.poses), drive.doubt, len(state)
    poses, pallets = state[: 3 * shots].reshape(-1, 3), state[3 * shots : -3].reshape(-1, 3)
    turn, scale, bias = state[-3:].tolist()
    steps, root = relative(drive.poses[:-1], drive.poses[1:]), np.sqrt(drive.durations)
    half = bias * drive.durations / 2
    ahead = turned(steps[:, :2], half)
    said = np.column_stack([(1 + scale) * ahead, steps[:, 2] + 2 * half])
    place = np.hypot(doubt.place * root, doubt.slip * np.sqrt(np.hypot(steps[:, 0], steps[:, 1])))
    sigma = np.stack([place, place, doubt.heading * root], axis=1)
    moved = relative(poses[:-1], poses[1:]) - said
    moved[:, 2] = wrap_angle(moved[:, 2])
    by_step = np.zeros((shots - 1, 3, columns))
    for k, (earlier, later) in enumerate(zip(*relative_slopes(poses[:-1], poses[1:]), strict=True)):
        by_step[k, :, 3 * k : 3 * k + 3], by_step[k, :, 3 * k + 3 : 3 * k + 6] = earlier, later
    by_step[:, :2, -2] = -ahead
    by_step[:, :2, -1] = -drive.durations[:, None] / 2 * quarter(said[:, :2])
    by_step[:, 2, -1] = -drive.durations
    constants = np.zeros((2, columns))
    constants[0, -2], constants[1, -1] = 1 / doubt.scale, 1 / doubt.bias
    off, by_sighting = _of_sightings(poses, pallets, turn, drive)
    residuals = [(moved / sigma).ravel(), [scale / doubt.scale, bias / doubt.bias], off.ravel()]
    slopes = [(by_step / sigma[:, :, None]).reshape(-1, columns), constants, by_sighting.reshape(-1, columns)]
    return np.concatenate(residuals), np.concatenate(slopes)


def _of_sightings(
    poses: FloatArray, pallets: FloatArray, turn: float, drive: _Drive
) -> tuple[FloatArray, FloatArray]:
    """Return what sightings contradict, (m, 3), and the derivative by the state, (m, 3, n)."""
    count, at = len(drive.shot), 3 * len(poses)
    angle = np.full(count, turn)
    expected = relative(poses[drive.shot], pallets[drive.pallet])
    seen = turned(expected[:, :2] - drive.center, angle)
    off = drive.measured - np.column_stack([seen + drive.center, expected[:, 2] + turn])
    off[:, 2] = wrap_angle(off[:, 2])
    slopes = np.zeros((count, 3, at + pallets.size + 3))
    rotation = np.eye(3)
    rotation[:2, :2] = turned(np.eye(2), angle[:2]).T
    by_pose, by_pallet = relative_slopes(poses[drive.shot], pallets[drive.pallet])
    for m, (shot, pallet) in enumerate(zip(drive.shot.tolist(), drive.pallet.tolist(), strict=True)):
        slopes[m, :, 3 * shot : 3 * shot + 3] = -rotation @ by_pose[m]
        slopes[m, :, at + 3 * pallet : at + 3 * pallet + 3] = -rotation @ by_pallet[m]
    slopes[:, :2, -3], slopes[:, 2, -3] = -quarter(seen), -1.0
    return np.einsum("mij,mj->mi", drive.whitening, off), drive.whitening @ slopes
