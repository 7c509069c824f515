"""Boards of `calibrate intrinsics` that are no markers, and the files in which Kalibr describes its targets."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.formats.fields import FormatError
from calibration.formats.syntax import read_documents
from calibration.targets.targets import AprilGrid
from palletloc.geometry import FloatArray
from palletloc.io.reading import require_file

_MOST = 1000
"""Tags or corners of a row that are read: boards have ten."""
_EVEN = 1e-6
"""Sides of a square that differ by less are equal, in metres."""


@dataclass(frozen=True, slots=True)
class Chessboard:
    """A plain chessboard."""

    columns: int
    """Inner corners side by side."""
    rows: int
    """Inner corners one above the other."""
    square: float
    """Side of a square, in metres."""

    @property
    def corners(self) -> FloatArray:
        """(n, 3) its inner corners, row by row, in metres."""
        x, y = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        grid = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
        return np.asarray(grid * self.square, dtype=np.float64)


def read_kalibr_target(path: Path) -> Chessboard | AprilGrid:
    """Return the board that a target's file of Kalibr describes.

    Parameters
    ----------
    path : Path
        With ``target_type`` ``aprilgrid`` or ``checkerboard``; the keys are those of Kalibr's wiki, "Calibration
        targets".

    Raises
    ------
    InputError
        If it cannot be read, is of another type, or holds something else; names the key.
    """
    fields = read_documents(require_file(path, "a target's file of Kalibr"))[0]
    kind = fields.at("target_type")
    if kind.value in ("circlegrid", "assymetric_circlegrid", "asymmetric_circlegrid"):
        raise FormatError(
            f"{path}: target_type: is a grid of circles, whose middles a fisheye shifts; expected an aprilgrid or a"
            " checkerboard"
        )
    if kind.text(("aprilgrid", "checkerboard")) == "aprilgrid":
        columns, rows = (fields.at(key).whole(1, _MOST) for key in ("tagCols", "tagRows"))
        first = fields.at("lowId").whole(0, _MOST) if fields.has("lowId") else 0
        return AprilGrid(columns, rows, fields.at("tagSize").number(), fields.at("tagSpacing").number(), first)
    columns, rows = (fields.at(key).whole(3, _MOST) for key in ("targetCols", "targetRows"))
    across, down = (fields.at(key).number() for key in ("colSpacingMeters", "rowSpacingMeters"))
    if not across > 0 or abs(across - down) > _EVEN:
        raise fields.at("rowSpacingMeters").fault(f"the positive colSpacingMeters, {across:g}: squares")
    return Chessboard(columns, rows, across)
