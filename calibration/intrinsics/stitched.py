"""What a stitcher got wrong: place, turn and bend of the two lenses behind an equirectangular image, from boards.

Each half of the image is a lens whose radius in the image is the angle off its axis. Against the stitcher's own
idea, a lens may be turned, may have its centre elsewhere, and may bend: eight numbers, or ten with both bends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.bearings import pose_from_bearings
from calibration.lenses.fit import LensFit, NoStartError, refined
from calibration.lenses.linking import link
from calibration.lenses.models import MODELS
from calibration.lenses.problem import BoardView, LensProblem, Rig
from palletloc.cameras import Equirectangular, StitchedEquirectangular, StitchedLens
from palletloc.geometry import BoolArray, FloatArray

_FISHEYE = MODELS["kannala_brandt"]
"""The model of the lenses: with its terms at zero the image is the one that the stitcher means."""
_BENDS = [_FISHEYE.parameters.index(name) for name in ("k1", "k2")]
"""Which of its parameters are fitted: the half of an image tells no more than two terms."""
_TURNED = RigidTransform.from_rotation(Rotation.from_euler("z", 180, degrees=True))
"""The back lens by the stitcher: turned by 180 degrees about the vertical."""
_SEAM = float(np.radians(3.0))
"""Corners nearer to the seam than this, in radians, may belong to either lens, or to a blend of both."""
_FEWEST = 6
"""A half with fewer corners counts for nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class StitchedFit:
    """The correction, and what it is worth."""

    before: LensFit
    """The boards with the stitcher's own idea of the lenses; its pixels are those of the halves."""
    after: LensFit
    """The boards with the corrected lenses."""
    camera: StitchedEquirectangular
    """The corrected camera."""

    @property
    def between(self) -> tuple[FloatArray, FloatArray]:
        """Turn (as a rotation vector) and distance of the back lens against its nominal place, (6,), and sigmas."""
        off = self.after.rig.lenses[1] * _TURNED.inv()
        values = np.concatenate([off.rotation.as_rotvec(), off.translation])
        return values, self.after.sigma[self.after.problem.columns()[1][1]]

    @property
    def bends(self) -> tuple[FloatArray, FloatArray]:
        """k1 and k2 of each lens, (2, 2), and their sigmas."""
        columns = self.after.problem.columns()[0]
        sigma = np.stack([self.after.sigma[at][_BENDS] for at in columns])
        return np.stack([values[_BENDS] for values in self.after.rig.values]), sigma


def whole_pose(camera: Equirectangular, view: BoardView) -> RigidTransform | None:
    """Return the pose of a board by the stitcher's own idea of the lenses; None where it has none."""
    return pose_from_bearings(view.points, camera.unproject(view.pixels).directions)


def fit_stitched(camera: Equirectangular, views: Sequence[BoardView], boards: int) -> StitchedFit:
    """Fit the two lenses behind a stitched image.

    Parameters
    ----------
    camera : Equirectangular
        The image as the stitcher means it.
    views : sequence of BoardView
        Boards in shots, with pixels of the whole image.
    boards : int
        How many boards stand still against each other; 1 where each has a pose of its own in each shot.

    Raises
    ------
    NoStartError
        If no board has a pose.
    UnlinkedError
        If some boards are never seen together with the others.
    LinAlgError
        If the boards leave an unknown open.
    """
    poses = [whole_pose(camera, view) for view in views]
    posed = [(view, pose) for view, pose in zip(views, poses, strict=True) if pose is not None]
    if not posed:
        raise NoStartError("no board has a pose; expected whole boards, seen sharply")
    shots = list(dict.fromkeys(view.shot for view, _ in posed))
    whole = [replace(view, shot=shots.index(view.shot), lens=0) for view, _ in posed]
    linked = link(whole, [pose for _, pose in posed], 1, boards)
    halves = tuple(half for view in whole for half in _halves(camera, view))
    problem = LensProblem(tuple(sorted(halves, key=lambda view: view.shot)), (_FISHEYE, _FISHEYE), boards)
    nominal = np.array([camera.width / (2 * np.pi)] * 2 + [0.0] * 6)
    lenses = RigidTransform.concatenate([RigidTransform.identity(), _TURNED])
    rig = Rig((nominal, nominal), lenses, linked.shots, linked.boards)
    before = refined(problem, rig, free=_free(problem, lenses=False))
    after = refined(problem, before.rig, free=_free(problem, lenses=True))
    return StitchedFit(before, after, _camera(camera, after))


def _free(problem: LensProblem, *, lenses: bool) -> BoolArray:
    """Return which unknowns are fitted: the boards, and, if asked for, place, turn and bends of the lenses."""
    parameters, lens_poses, board_poses = problem.columns()
    free = np.zeros(len(problem.names()), dtype=np.bool_)
    for at in board_poses:
        free[at] = True
    if lenses:
        free[lens_poses[1]] = True
        for at in parameters:
            free[np.arange(at.start, at.stop)[_BENDS]] = True
    return free


def _halves(camera: Equirectangular, view: BoardView) -> list[BoardView]:
    """Return what each lens shows of a board, in pixels of an equidistant lens as fine as the image."""
    rays = camera.unproject(view.pixels).directions
    density = camera.width / (2 * np.pi)
    found = []
    for lens, sign in enumerate((1.0, -1.0)):
        own = sign * rays[:, 0] > np.sin(_SEAM)
        if own.sum() < _FEWEST:
            continue
        mine = rays[own] * [sign, sign, 1.0]
        across = np.maximum(np.hypot(mine[:, 1], mine[:, 2]), 1e-12)
        radius = density * np.arctan2(across, mine[:, 0]) / across
        pixels = np.stack([-radius * mine[:, 1], -radius * mine[:, 2]], axis=-1)
        found.append(replace(view.kept(own), name=f"{view.name} {('front', 'back')[lens]}", lens=lens, pixels=pixels))
    return found


def _camera(camera: Equirectangular, fit: LensFit) -> StitchedEquirectangular:
    """Return the camera in the frame midway between the lenses, so that neither of them is the right one."""
    off = fit.rig.lenses[1] * _TURNED.inv()
    turn = Rotation.from_rotvec(off.rotation.as_rotvec() / 2)
    shift = np.linalg.solve(np.eye(3) + turn.as_matrix(), off.translation)
    half = RigidTransform.from_components(shift, turn)
    bends = [[float(values[i]) for i in _BENDS] for values in fit.rig.values]
    return StitchedEquirectangular(
        camera.width, camera.height, StitchedLens(half.inv(), *bends[0]), StitchedLens(half * _TURNED, *bends[1])
    )
