"""Pallets on the shelf, seen by the localizer although the plane is known only roughly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from calibration.drive import compose, evenly_spread
from palletloc.config import LocalizerConfig
from palletloc.errors import PalletLocError
from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.io.recording import Recording
from palletloc.localizer import Localizer
from palletloc.shelf import ShelfPlane

_MIN_SCORE = 0.8
"""Pallets with a lower score do not count here: a wrong one costs more than a missing one."""
_NEAR = 0.15
"""Pallets whose depths differ by less, in metres, stand on one plane."""
_FIRST_SHOTS = 4
"""Shots of the wide first look, which is slow."""


@dataclass(frozen=True, slots=True)
class _Reach:
    """How far a plane may be off."""

    depth: float
    """In metres."""
    yaw: float
    """In radians."""


_TRIED = tuple((depth, float(np.radians(yaw))) for depth in (-0.3, 0.05, 0.4) for yaw in (-7.0, 0.0, 7.0))
"""Planes that are tried around the user's, by depth and yaw: together they cover half a metre and ten degrees."""
_FIRST = _Reach(0.25, float(np.radians(4.5)))
"""How far planes may be off in the first look: half the distance of those that are tried."""
_AGAIN, _LAST = _Reach(0.15, float(np.radians(4.0))), _Reach(0.08, float(np.radians(1.5)))
"""The same in the second look, and once poses are known."""


@dataclass(frozen=True, slots=True, eq=False)
class PalletObservation:
    """One pallet in one shot."""

    shot: int
    """Index of the shot."""
    model: str
    """The pallet's model."""
    pose: LevelPose
    """``forklift_from_pallet``."""
    covariance: FloatArray
    """(3, 3) of x, y and yaw, in metres and radians."""

    @property
    def planar(self) -> FloatArray:
        """x, y and yaw, (3,)."""
        return self.pose.as_array()[[0, 1, 3]]


def find_pallets(
    recording: Recording, shots: Sequence[int], prior: ShelfPlane, on_progress: Callable[[str], None] = lambda _: None
) -> tuple[list[PalletObservation], ShelfPlane]:
    """Localize the pallets of a recording, first widely around a rough plane, then around what that gives.

    Parameters
    ----------
    recording : Recording
        The recording.
    shots : sequence of int
        Which of its shots to use.
    prior : ShelfPlane
        Rough front plane, in odom.
    on_progress : callable
        Is told what is done next.

    Returns
    -------
    sights : list of PalletObservation
        Numbered by their place in `shots`.
    plane : ShelfPlane
        What the second look was given: the prior itself where the first finds no pallet.
    """
    spread = evenly_spread(len(shots), _FIRST_SHOTS)
    on_progress("looking for pallets widely")
    few = [(int(i), shots[i]) for i in spread]
    tried = (_moved(recording, prior, depth, yaw) for depth, yaw in _TRIED)
    first = [sight for plane in tried for sight in _look(recording, few, plane, _FIRST)]
    plane = _rough_plane(recording, shots, first, prior)
    if plane is None:
        return [], prior
    on_progress("localizing pallets")
    return _look(recording, list(enumerate(shots)), plane, _AGAIN), plane


def _moved(recording: Recording, prior: ShelfPlane, depth: float, yaw: float) -> ShelfPlane:
    """Return a plane moved into the shelf and turned about the camera's foot on it at the middle of the way."""
    shots = recording.shots
    middle = recording.odometry.pose_at(shots[len(shots) // 2].time)
    x, y, _ = middle.transform().apply(recording.forklift_from_camera.translation)
    into = np.array([np.cos(prior.yaw), np.sin(prior.yaw)])
    distance = float((np.array([prior.x, prior.y]) - (x, y)) @ into)
    foot = np.array([x, y]) + (distance + depth) * into
    return replace(prior, x=float(foot[0]), y=float(foot[1]), facing=float(wrap_angle(prior.facing + yaw)))


def find_pallets_again(
    recording: Recording, shots: Sequence[int], poses: FloatArray, plane: ShelfPlane
) -> list[PalletObservation]:
    """Localize the pallets of a recording once plane and poses are known well.

    Parameters
    ----------
    recording, shots
        As for `find_pallets`.
    poses : (n, 3) array
        ``odom_from_forklift`` at these, without the odometry's drift.
    plane : ShelfPlane
        About the fronts of the pallets, in odom.

    Returns
    -------
    list of PalletObservation
        Numbered by their place in `shots`.
    """
    shelves = [plane.seen_from(LevelPose(float(x), float(y), 0.0, float(yaw))) for x, y, yaw in poses]
    return _localized(recording, [(i, shot, shelves[i]) for i, shot in enumerate(shots)], _LAST)


def _look(
    recording: Recording, numbered: Sequence[tuple[int, int]], plane: ShelfPlane, reach: _Reach
) -> list[PalletObservation]:
    moved = replace(recording, shelf=plane)
    shelves = []
    for number, index in numbered:
        with suppress(PalletLocError):
            shelves.append((number, index, moved.shelf_at(recording.shots[index].time)))
    return _localized(recording, shelves, reach)


def _localized(
    recording: Recording, numbered: Sequence[tuple[int, int, ShelfPlane]], reach: _Reach
) -> list[PalletObservation]:
    config = LocalizerConfig()
    detection = replace(config.detection, plane_depth=reach.depth, plane_yaw_deg=float(np.degrees(reach.yaw)))
    config = replace(config, detection=detection)
    localizer = Localizer(recording.models, config=config)
    keep = np.ix_([0, 1, 3], [0, 1, 3])
    seen: list[PalletObservation] = []
    for number, index, shelf in numbered:
        try:
            found = localizer.localize(recording.shot(recording.shots[index]), shelf)
        except PalletLocError:  # a shot that cannot be used: too near, or damaged; others may do
            continue
        seen += [
            PalletObservation(
                number, measurement.model, measurement.forklift_from_pallet, measurement.covariance[keep]
            )
            for measurement in found
            if measurement.score >= _MIN_SCORE
        ]
    return seen


def _rough_plane(
    recording: Recording, shots: Sequence[int], seen: Sequence[PalletObservation], prior: ShelfPlane
) -> ShelfPlane | None:
    """Return the plane that most pallets stand on, by raw odometry; None where there is none.

    Some of the sights may be wrong. The prior gives the levels, and the sides.
    """
    if not seen:
        return None
    at = [recording.odometry.pose_at(recording.shots[shots[sight.shot]].time) for sight in seen]
    poses = np.array([compose(np.array([p.x, p.y, p.yaw]), sight.planar) for p, sight in zip(at, seen, strict=True)])
    turned = wrap_angle(poses[:, 2] - prior.yaw)
    near = np.abs(turned[:, None] - turned) < np.radians(4.0)
    yaw = prior.yaw + float(np.median(turned[near[near.sum(1).argmax()]]))
    into = np.array([np.cos(yaw), np.sin(yaw)])
    depth = poses[:, :2] @ into
    agree = np.abs(depth[:, None] - depth) < _NEAR
    best = agree[agree.sum(1).argmax()]
    point = np.median(poses[best, :2], axis=0)
    point += (np.median(depth[best]) - point @ into) * into
    return replace(prior, x=float(point[0]), y=float(point[1]), facing=float(wrap_angle(yaw + np.pi)))
