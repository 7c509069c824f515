"""Boards in shots through lenses as one least-squares problem: pixels with derivatives, and the rig that fits best.

A point ``p`` of a board is at ``T_shot T_board p`` in the camera frame and at its lens after the inverse of
``camera_from_lens``. The poses of shots appear in their own corners only and are eliminated, so that many views take
no time; all else is shared.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.bearings import cross_matrices
from calibration.least_squares import descend_damped, finite_cost
from calibration.lenses.models import LensModel
from palletloc.geometry import BoolArray, FloatArray

_DAMPING, _MAX_STEPS, _SETTLED = 1e-4, 60, 1e-10
"""Of the fit: its first damping; its steps, of which 10 are usual; the relative gain at which it ends."""
_FLOOR = 1e-12
"""Added to the diagonal of the normal equations: keeps unknowns of which nothing is told where they are."""
_OBSERVED = 1e-13
"""Least eigenvalue of the correlation matrix's inverse with which a float64 tells all unknowns."""


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """Corners of one board, as one lens shows them in one shot."""

    name: str
    """For people: of the shot, and of board and lens where there are several."""
    shot: int
    """Number of the shot, or of shot and board where boards move."""
    board: int
    """Number of the board; 0 where boards move."""
    lens: int
    """Number of the lens."""
    points: FloatArray
    """(n, 3) in the board's frame, in metres."""
    pixels: FloatArray
    """(n, 2) where they are seen."""
    sigma: FloatArray
    """(n,) standard deviation of each coordinate, in pixels."""

    def kept(self, keep: BoolArray) -> BoardView:
        """Return the view with some corners only."""
        return replace(self, points=self.points[keep], pixels=self.pixels[keep], sigma=self.sigma[keep])


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """All unknowns."""

    values: tuple[FloatArray, ...]
    """Parameters of each lens."""
    lenses: RigidTransform
    """Stack of ``camera_from_lens``; the first one stays as it is."""
    shots: RigidTransform
    """Stack of ``camera_from_world``, one for each shot; the world is the first board."""
    boards: RigidTransform
    """Stack of ``world_from_board``; the first one stays as it is."""

    def lens_from_board(self, view: BoardView) -> RigidTransform:
        """Return the pose of a view's board in front of its lens."""
        return self.lenses[view.lens].inv() * self.shots[view.shot] * self.boards[view.board]


@dataclass(frozen=True, slots=True, eq=False)
class Linearization:
    """How far a rig is from all corners, in the order of the views, in units of their sigma."""

    residuals: FloatArray
    """(n, 2) predicted minus seen."""
    by_shared: FloatArray
    """(n, 2, g) by the shared unknowns."""
    by_shot: FloatArray
    """(n, 2, 6) by rotation and translation of the corner's own shot."""


@dataclass(frozen=True, slots=True, eq=False)
class LensProblem:
    """The observations, ready to be compared with rigs."""

    views: tuple[BoardView, ...]
    """In the order of their shots."""
    models: tuple[LensModel, ...]
    """Of each lens."""
    boards: int = 1
    """How many boards have poses relative to each other."""

    @property
    def shot_of(self) -> NDArray[np.intp]:
        """(n,) number of each corner's shot."""
        shots = np.array([view.shot for view in self.views], dtype=np.intp)
        return np.repeat(shots, [len(view.points) for view in self.views])

    def names(self) -> tuple[str, ...]:
        """Return the names of the shared unknowns."""
        several = len(self.models) > 1
        names = [
            f"{name}{lens}" if several else name
            for lens, model in enumerate(self.models)
            for name in model.parameters
        ]
        pose = ("rx", "ry", "rz", "x", "y", "z")
        names += [f"lens{lens}.{axis}" for lens in range(1, len(self.models)) for axis in pose]
        return (*names, *(f"board{board}.{axis}" for board in range(1, self.boards) for axis in pose))

    def columns(self) -> tuple[list[slice], list[slice], list[slice]]:
        """Return where each lens's parameters, its pose and each board's pose stand among the shared unknowns."""
        ends = np.cumsum([0, *(len(model.parameters) for model in self.models)])
        parameters = [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]
        first = int(ends[-1])
        lens_poses = [slice(0, 0), *(slice(first + 6 * i, first + 6 * i + 6) for i in range(len(self.models) - 1))]
        first += 6 * (len(self.models) - 1)
        board_poses = [slice(0, 0), *(slice(first + 6 * i, first + 6 * i + 6) for i in range(self.boards - 1))]
        return parameters, lens_poses, board_poses

    def linearize(self, rig: Rig) -> Linearization:
        """Return residuals and derivatives; NaN where a lens has no image of a corner."""
        parameters, lens_poses, board_poses = self.columns()
        counts = [len(view.points) for view in self.views]
        shot, lens, board = (
            np.repeat(np.array(numbers), counts)
            for numbers in zip(*((view.shot, view.lens, view.board) for view in self.views), strict=True)
        )
        shots, lenses, boards = (poses.as_matrix() for poses in (rig.shots, rig.lenses, rig.boards))
        on_board = _rotated(boards[board, :3, :3], np.concatenate([view.points for view in self.views]))
        turned = _rotated(shots[shot, :3, :3], on_board + boards[board, :3, 3])
        from_lens = turned + shots[shot, :3, 3] - lenses[lens, :3, 3]
        to_lens = np.swapaxes(lenses[lens, :3, :3], 1, 2)
        rays = _rotated(to_lens, from_lens)
        pixels, by_camera = np.empty((len(rays), 2)), np.empty((len(rays), 2, 3))
        shared = np.zeros((len(rays), 2, len(self.names())))
        for number, model in enumerate(self.models):
            mine = np.flatnonzero(lens == number)
            imaged = model.evaluate(rig.values[number], rays[mine])
            pixels[mine], by_camera[mine] = imaged.pixels, imaged.by_ray @ to_lens[mine]
            shared[mine, :, parameters[number]] = imaged.by_values
            if number:
                shared[mine, :, lens_poses[number]] = -_by_pose(by_camera[mine], from_lens[mine])
        for number in range(1, self.boards):
            mine = np.flatnonzero(board == number)
            by_world = by_camera[mine] @ shots[shot[mine], :3, :3]
            shared[mine, :, board_poses[number]] = _by_pose(by_world, on_board[mine])
        scale = 1 / np.concatenate([view.sigma for view in self.views])[:, None]
        seen = np.concatenate([view.pixels for view in self.views])
        by_shot = _by_pose(by_camera, turned)
        return Linearization((pixels - seen) * scale, shared * scale[..., None], by_shot * scale[..., None])

    def moved(self, rig: Rig, shared: FloatArray, shots: FloatArray) -> Rig | None:
        """Return a rig after a step, or None where its parameters describe no lens."""
        parameters, lens_poses, board_poses = self.columns()
        values = tuple(old + shared[at] for old, at in zip(rig.values, parameters, strict=True))
        if not all(model.admits(lens) for model, lens in zip(self.models, values, strict=True)):
            return None
        still = np.zeros((1, 6))
        lenses, boards = (
            _turned(poses, np.concatenate([still, *(shared[None, at] for at in columns[1:])]))
            for poses, columns in ((rig.lenses, lens_poses), (rig.boards, board_poses))
        )
        return Rig(values, lenses, _turned(rig.shots, shots), boards)


def _rotated(rotations: FloatArray, vectors: FloatArray) -> FloatArray:
    rotated: FloatArray = np.einsum("nij,nj->ni", rotations, vectors)
    return rotated


def _by_pose(by_point: FloatArray, arm: FloatArray) -> FloatArray:
    """Return derivatives by a rotation, about the pose's own origin, and a translation: (n, 2, 6)."""
    return np.concatenate([-by_point @ cross_matrices(arm), by_point], axis=-1)


def _turned(poses: RigidTransform, steps: FloatArray) -> RigidTransform:
    """Return a stack of poses after steps, (n, 6), of rotation about their own origins and translation."""
    return RigidTransform.from_components(
        poses.translation + steps[:, 3:], Rotation.from_rotvec(steps[:, :3]) * poses.rotation
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Normal:
    """Normal equations: shared unknowns, each shot, and what couples them."""

    shared: FloatArray
    by_shared: FloatArray
    shots: FloatArray
    by_shots: FloatArray
    coupling: FloatArray


class _Reached(NamedTuple):
    """A rig, and how far it is from the corners."""

    rig: Rig
    residuals: Linearization


def adjust(problem: LensProblem, start: Rig, free: BoolArray | None = None, robust: float = np.inf) -> Rig:
    """Return the rig with the least sum of losses, from a start near it.

    Parameters
    ----------
    problem : LensProblem
        The observations.
    start : Rig
        Where to begin.
    free : (g,) array of bool, optional
        Which shared unknowns may change; all by default.
    robust : float
        Residuals well beyond this many sigmas count by their size instead of their square (soft l1).
    """

    def step(reached: _Reached) -> Callable[[float], _Reached | None]:
        normal = _normal(reached.residuals, problem.shot_of, len(reached.rig.shots), robust)

        def damped(damping: float) -> _Reached | None:
            rig = _trial(problem, reached.rig, normal, damping, free)
            return None if rig is None else _Reached(rig, problem.linearize(rig))

        return damped

    first = _Reached(start, problem.linearize(start))
    return descend_damped(
        first, lambda reached: _cost(reached.residuals, robust), step, _DAMPING, _MAX_STEPS, _SETTLED
    ).rig


def shared_covariance(problem: LensProblem, rig: Rig, free: BoolArray | None = None) -> FloatArray:
    """Return the covariance of the shared unknowns for residuals of unit variance; zero for those that are not free.

    Parameters
    ----------
    problem : LensProblem
        The observations.
    rig : Rig
        The solution.
    free : (g,) array of bool, optional
        Which shared unknowns were fitted; all by default.

    Raises
    ------
    LinAlgError
        If the observations leave one of them open.
    """
    at = problem.linearize(rig)
    normal = _normal(at, problem.shot_of, len(rig.shots), np.inf)
    reduced, _ = _reduced(normal, normal.shots)
    whole = np.zeros_like(reduced)
    chosen = np.ones(len(reduced), dtype=np.bool_) if free is None else free
    if not chosen.any():
        return whole
    reduced = reduced[np.ix_(chosen, chosen)]
    size = np.sqrt(np.diag(reduced))
    if not (size > 0).all():
        raise np.linalg.LinAlgError("an unknown is not observed")
    scaled = reduced / np.outer(size, size)
    if np.linalg.eigvalsh(scaled)[0] < _OBSERVED:
        raise np.linalg.LinAlgError("a combination of unknowns is not observed")
    whole[np.ix_(chosen, chosen)] = np.linalg.inv(scaled) / np.outer(size, size)
    return whole


def _cost(at: Linearization, robust: float) -> float:
    squared = (at.residuals**2).sum(-1)
    if np.isinf(robust):
        return finite_cost(squared)
    return finite_cost(2 * robust**2 * (np.sqrt(1 + squared / robust**2) - 1))


def _normal(at: Linearization, shot_of: NDArray[np.intp], shots: int, robust: float) -> _Normal:
    residuals, by_shared, by_shot = at.residuals, at.by_shared, at.by_shot
    if np.isfinite(robust):
        weight = (1 + (residuals**2).sum(-1) / robust**2) ** -0.25  # root of the loss's slope
        residuals = residuals * weight[:, None]
        by_shared, by_shot = by_shared * weight[:, None, None], by_shot * weight[:, None, None]
    flat = by_shared.reshape(-1, by_shared.shape[-1])
    width = flat.shape[1]
    own, coupling, gradient = np.zeros((shots, 6, 6)), np.zeros((shots, width, 6)), np.zeros((shots, 6))
    np.add.at(own, shot_of, np.einsum("nij,nik->njk", by_shot, by_shot))
    np.add.at(coupling, shot_of, np.einsum("nij,nik->njk", by_shared, by_shot))
    np.add.at(gradient, shot_of, np.einsum("nij,ni->nj", by_shot, residuals))
    return _Normal(flat.T @ flat, flat.T @ residuals.ravel(), own, gradient, coupling)


def _reduced(normal: _Normal, shots: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the normal matrix of the shared unknowns without the shots, and what takes shots to shared ones."""
    takes = np.asarray(np.linalg.solve(shots, np.swapaxes(normal.coupling, 1, 2)), dtype=np.float64)
    reduced: FloatArray = normal.shared - np.einsum("sij,sjk->ik", normal.coupling, takes)
    return reduced, takes


def _trial(problem: LensProblem, rig: Rig, normal: _Normal, damping: float, free: BoolArray | None) -> Rig | None:
    """Return the rig after one damped step, or None where there is none."""
    own = normal.shots.copy()
    diagonal = np.einsum("sii->si", own)
    diagonal += damping * diagonal + _FLOOR
    try:
        reduced, takes = _reduced(normal, own)
        reduced[np.diag_indices_from(reduced)] += damping * np.diag(normal.shared) + _FLOOR
        right = normal.by_shared - np.einsum("sji,sj->i", takes, normal.by_shots)
        chosen = np.ones(len(right), dtype=np.bool_) if free is None else free
        shared = np.zeros_like(right)
        shared[chosen] = -np.linalg.solve(reduced[np.ix_(chosen, chosen)], right[chosen])
        alone = np.linalg.solve(own, normal.by_shots[..., None])[..., 0]
    except np.linalg.LinAlgError:
        return None
    return problem.moved(rig, shared, -alone - takes @ shared)
