"""The file intrinsics.yaml: a camera's size, shots of boards or files of their corners, and what is known before."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from calibration.intrinsics.kalibr_target import Chessboard as Chessboard
from calibration.intrinsics.kalibr_target import read_kalibr_target
from calibration.lenses.fit import Aperture
from calibration.targets.target_file import (
    AprilGridSpec,
    CharucoSpec,
    Positive,
    april_grid,
    charuco_board,
    checked_target,
    refuse_shared_ids,
)
from calibration.targets.targets import AprilGrid, CharucoBoard
from palletloc.cameras import CameraModel, DualFisheye
from palletloc.io.camera_spec import camera_from_spec
from palletloc.io.reading import InputError, require_file
from palletloc.io.schema import Angle, CameraSpec, Pixels
from palletloc.io.yaml_document import Document, DocumentError, read_document

INTRINSICS = "intrinsics.yaml"
"""Name of the file in its folder."""


class _ChessboardSpec(Document):
    """A plain chessboard."""

    inner_columns: Annotated[int, Field(strict=True, ge=3)]
    """Corners side by side where four squares meet."""
    inner_rows: Annotated[int, Field(strict=True, ge=3)]
    """Such corners one above the other."""
    square_m: Positive


class _BoardSpec(Document):
    """One board: `chessboard`, `charuco`, `aprilgrid`, or a file of Kalibr's that describes it."""

    chessboard: _ChessboardSpec | None = None
    charuco: CharucoSpec | None = None
    aprilgrid: AprilGridSpec | None = None
    kalibr: str | None = None
    """A target's file of Kalibr, relative to the folder."""


class _IntrinsicsSpec(Document):
    """The file intrinsics.yaml."""

    format: Literal[1]
    width: Pixels
    height: Pixels
    lenses: Literal[1, 2] = 1
    """2: two image circles side by side, the front lens's at the left."""
    start: CameraSpec | None = None
    """Roughly known camera; found without it, as a rule."""
    max_angle_deg: Angle | None = None
    """How far off its axis the lens sees; without it, as far as the corners reach."""
    shots: tuple[str, ...] = ()
    """Images, relative to the folder."""
    boards: Annotated[dict[str, _BoardSpec], Field(default_factory=dict)]
    boards_stand_still: bool = False
    """Whether only the camera moves, so that all boards keep their places against each other."""
    corners: str | None = None
    """A file of corners in place of shots and boards, relative to the folder."""


CodedBoard = CharucoBoard | AprilGrid
"""A board with markers."""
_Board = Chessboard | CodedBoard
"""Any board."""


@dataclass(frozen=True, slots=True, eq=False)
class IntrinsicsTask:
    """What the file says."""

    folder: Path
    """Where it is."""
    size: tuple[int, int]
    """Width and height of the shots, in pixels."""
    lenses: int
    """How many there are."""
    start: CameraModel | None
    """Roughly known camera."""
    max_angle: float | None
    """How far the lens sees, in radians."""
    shots: tuple[str, ...]
    """Images, relative to the folder."""
    boards: dict[str, _Board]
    """By name."""
    boards_stand_still: bool
    """Whether all boards keep their places against each other."""
    corners: Path | None
    """A file of corners."""

    @property
    def apertures(self) -> tuple[Aperture, ...]:
        """The part of the image that each lens fills."""
        width, height = self.size
        if self.lenses == 1:
            return (Aperture(np.array([(width - 1) / 2, (height - 1) / 2]), float(max(width, height))),)
        middles = ((width / 4 - 0.5, height / 2 - 0.5), (0.75 * width - 0.5, height / 2 - 0.5))
        return tuple(Aperture(np.array(middle), width / 2) for middle in middles)

    def start_of_lens(self, lens: int) -> CameraModel | None:
        """Return the roughly known camera of one lens, in the image of both."""
        if isinstance(self.start, DualFisheye):
            return (self.start.front, self.start.back)[lens].model
        return self.start


def read_intrinsics(folder: Path) -> IntrinsicsTask:
    """Read and check the file intrinsics.yaml of a folder; shots and corners stay in their files.

    Raises
    ------
    PalletLocError
        If the file is missing or wrong; names file, key and what was expected.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected one with {INTRINSICS} in it")
    path = require_file(folder / INTRINSICS, "the size of the shots, their boards or a file of corners")
    spec = read_document(path, _IntrinsicsSpec)
    if (spec.corners is None) == (not spec.shots):
        raise DocumentError(f"{path}: expected either the keys shots and boards, or the key corners")
    if spec.shots and not spec.boards:
        raise DocumentError(f"{path}: boards: is missing; expected one board at least")
    boards = {name: _board(path, f"{path}: boards.{name}", board) for name, board in spec.boards.items()}
    _check_boards(path, boards)
    return IntrinsicsTask(
        folder,
        (spec.width, spec.height),
        spec.lenses,
        _start(path, spec),
        None if spec.max_angle_deg is None else float(np.radians(spec.max_angle_deg)),
        spec.shots,
        boards,
        spec.boards_stand_still,
        None if spec.corners is None else folder / spec.corners,
    )


def _start(path: Path, spec: _IntrinsicsSpec) -> CameraModel | None:
    if spec.start is None:
        return None
    if (spec.start.width, spec.start.height) != (spec.width, spec.height):
        raise DocumentError(
            f"{path}: start: is {spec.start.width} x {spec.start.height} px, expected {spec.width} x {spec.height} px"
        )
    try:
        camera = camera_from_spec(spec.start)
    except ValueError as error:
        raise DocumentError(f"{path}: start: {error}") from error
    if isinstance(camera, DualFisheye) != (spec.lenses == 2):
        raise DocumentError(f"{path}: start.model: expected dual_fisheye for two lenses, and only for them")
    return camera


def _board(path: Path, where: str, spec: _BoardSpec) -> _Board:
    given = [value for value in (spec.chessboard, spec.charuco, spec.aprilgrid, spec.kalibr) if value is not None]
    match given:
        case [_ChessboardSpec() as board]:
            return Chessboard(board.inner_columns, board.inner_rows, board.square_m)
        case [CharucoSpec() as board]:
            return checked_target(where, charuco_board(board))
        case [AprilGridSpec() as board]:
            return checked_target(where, april_grid(board))
        case [str() as name]:
            found = read_kalibr_target(path.parent / name)
            return found if isinstance(found, Chessboard) else checked_target(str(path.parent / name), found)
        case _:
            raise DocumentError(f"{where}: expected one of the keys chessboard, charuco, aprilgrid and kalibr")


def _check_boards(path: Path, boards: dict[str, _Board]) -> None:
    """Raise an error where boards cannot be told apart."""
    plain = [name for name, board in boards.items() if isinstance(board, Chessboard)]
    if len(plain) > 1:
        raise DocumentError(
            f"{path}: boards.{plain[1]}: is a second plain chessboard, which cannot be told from {plain[0]};"
            " expected ChArUco boards where there are several"
        )
    coded = {name: board for name, board in boards.items() if not isinstance(board, Chessboard)}
    refuse_shared_ids(path, coded, "boards")
