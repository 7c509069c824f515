"""Inner corners of plain chessboards: found by both of OpenCV's detectors, refined, and the truer ones kept.

Neither detector sees all that a person sees. ``findChessboardCorners`` joins dark quads and wants them some pixels
apart, which a larger image gives it; ``findChessboardCornersSB`` (A. Duda, U. Frese, "Accurate detection and
localization of checkerboard corners for calibration", BMVC 2018) looks for saddles and follows straight rows. Corners
are refined where the gradients around them are orthogonal to the way to them (W. Förstner, E. Gülch, 1987;
``cornerSubPix``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike

from palletloc.geometry import BoolArray, FloatArray, Image

_QUADS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
"""How quads are looked for."""
_SADDLES = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE
"""How saddles are looked for."""
_SCALES, _MORE_SCALES = (2.0, 1.0), (1.5, 0.75, 0.5, 3.0, 4.0)
"""Sizes at which quads are looked for, and those that are tried where nothing is found: most rendered fisheye boards,
whose squares are 6 px wide and more, are found at twice their size."""
_SADDLE_SCALE = 2.0
"""Size at which saddles are looked for once more, where all else finds nothing."""
_LARGEST_SIDE, _LARGEST_SADDLE_SIDE = 4096, 2048
"""Of an enlarged image in which quads and saddles are looked for, in pixels: larger ones take seconds."""
_LARGEST_HALF, _SMALLEST_HALF = 5, 2
"""Half sides of the window around a corner, in pixels: larger ones lean on the lens, smaller ones on noise."""
_TRUE = 0.3
"""A corner that is farther off a smooth board, as a part of the way to its next one, is one of something else."""
_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-3)
"""When the refinement of a corner ends: after so many steps, or below so many pixels."""
_DEGREES = ((24, 4, 2), (17, 3, 2), (10, 2, 1), (0, 1, 1))
"""Degrees of a smooth map and of its divisor, by how many corners there are at least: three of their coordinates for
two unknowns. Without noise the first is 0.004 px off as a rule, and 0.04 px where a board fills a fisheye."""
_STIFF = ((20, 3, 2), (12, 2, 1), (0, 1, 1))
"""The same of a map that follows a wrong corner less."""
_WRONG, _DOUBT, _DOUBT_PX, _LEAST_FREE = 8, 0.06, 1.0, 0.05
"""One corner of so many may be wrong at most; it is if it lies off the others' map by this part of the way to its
next one, or by so many pixels where that is more; and the least part of a corner that a map leaves to itself."""
_MENDINGS = 4
"""How often wrong corners are found anew: each round's map is truer than the last."""
_ROUNDS = 4
"""Of the map's linear fits: its divisor no longer changes."""


def find_chessboard(image: Image, columns: int, rows: int) -> FloatArray | None:
    """Return the pixels of a board's inner corners, row by row.

    Parameters
    ----------
    image : (height, width) array of uint8
        A shot in gray.
    columns, rows : int
        Inner corners side by side and one above the other.

    Returns
    -------
    (n, 2) array, optional
        None where the board is not seen whole.
    """
    found = list[FloatArray]()
    for seen in _candidates(image, (columns, rows)):
        refined = _refined(image, seen, columns)
        found += [seen, refined, _mended(image, refined, columns)]
    best = min(found, key=lambda corners: float((off_smooth_board(corners, columns) ** 2).sum()), default=None)
    return best if best is not None and _on_board(best, columns) else None


def _on_board(corners: FloatArray, columns: int) -> bool:
    off = np.linalg.norm(off_smooth_board(corners, columns), axis=-1)
    return bool((off <= _TRUE * _distances(corners, columns)).all())


def sees_chessboard(image: Image, columns: int, rows: int) -> bool:
    """Return whether a shot shows a board at first sight; arguments as for `find_chessboard`."""
    found, corners = cv2.findChessboardCorners(image, (columns, rows), flags=_QUADS)
    return bool(found) and _on_board(_at_full_size(corners, 1.0), columns)


def _candidates(image: Image, size: tuple[int, int]) -> Iterator[FloatArray]:
    """Yield what the detectors find, roughly; fewer ways are tried where the first ones do."""
    seen = list(_saddles(image, size, 1.0))
    yield from seen
    for scales in (_SCALES, _MORE_SCALES):
        for scale in scales:
            if scale <= 1 or scale * max(image.shape) <= _LARGEST_SIDE:
                found, quads = cv2.findChessboardCorners(_resized(image, scale), size, flags=_QUADS)
                seen += [_at_full_size(quads, scale)] if found else []
                yield from seen[-1:] if found else ()
        if seen:
            return
    if _SADDLE_SCALE * max(image.shape) <= _LARGEST_SADDLE_SIDE:
        yield from _saddles(image, size, _SADDLE_SCALE)


def _saddles(image: Image, size: tuple[int, int], scale: float) -> Iterator[FloatArray]:
    found, saddles = cv2.findChessboardCornersSB(_resized(image, scale), size, flags=_SADDLES)
    if found:
        yield _at_full_size(saddles, scale)


def _resized(image: Image, scale: float) -> Image:
    if scale == 1:
        return image
    way = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=way), dtype=np.uint8)


def _at_full_size(corners: ArrayLike, scale: float) -> FloatArray:
    """Return where corners are in the image itself; middles of pixels are whole numbers at both sizes."""
    place: FloatArray = (np.asarray(corners, dtype=np.float64).reshape(-1, 2) + 0.5) / scale - 0.5
    return place


def _refined(image: Image, corners: FloatArray, columns: int) -> FloatArray:
    """Return the corners where gradients meet; those that would leave their window stay."""
    half = int(np.clip(_distances(corners, columns).min() / 2, _SMALLEST_HALF, _LARGEST_HALF))
    start = corners.astype(np.float32).reshape(-1, 1, 2)
    moved = np.asarray(cv2.cornerSubPix(image, start, (half, half), (-1, -1), _STOP), dtype=np.float64).reshape(-1, 2)
    return np.where(np.linalg.norm(moved - corners, axis=-1, keepdims=True) > half, corners, moved)


def _distances(corners: FloatArray, columns: int) -> FloatArray:
    """Return how far each corner, (n, 2) row by row, is from its next neighbour, (n,) in pixels."""
    grid = corners.reshape(-1, columns, 2)
    down, across = (np.linalg.norm(np.diff(grid, axis=axis), axis=-1) for axis in (0, 1))
    ends = ((1, 1), (0, 0)), ((0, 0), (1, 1))
    down, across = (np.pad(gaps, end, constant_values=np.inf) for gaps, end in zip((down, across), ends, strict=True))
    next_to = np.minimum(np.minimum(down[:-1], down[1:]), np.minimum(across[:, :-1], across[:, 1:]))
    return np.asarray(next_to.ravel(), dtype=np.float64)


def off_smooth_board(corners: FloatArray, columns: int) -> FloatArray:
    """Return how far corners, (n, 2) row by row, lie off a smooth map of their board, (n, 2) in pixels."""
    off: FloatArray = corners - _smooth_map(corners, columns, np.ones(len(corners), dtype=np.bool_))[0]
    return off


def _smooth_map(
    corners: FloatArray, columns: int, used: BoolArray, degrees: Sequence[tuple[int, int, int]] = _DEGREES
) -> tuple[FloatArray, FloatArray]:
    """Return where a smooth map of the board to the image has all corners, (n, 2), and how much each pulls it, (n,).

    The map is a quotient of polynomials, fitted to the used corners, so that no lens is needed: the divisor is the
    perspective, the rest the lens.
    """
    down, across = np.divmod(np.arange(len(corners)), columns)
    x, y = (2 * place / max(place.max(), 1) - 1 for place in (across, down))
    degree, below = next((above, below) for least, above, below in degrees if used.sum() >= least)
    above, divisor = _terms(x, y, degree), _terms(x, y, below)[:, 1:]
    middle, spread = corners[used].mean(0), max(float(corners[used].std()), 1e-9)
    place = (corners - middle) / spread
    blocks = [np.hstack([above * (i == 0), above * (i == 1), -place[:, i : i + 1] * divisor]) for i in (0, 1)]
    weight = used.astype(np.float64)
    for _ in range(_ROUNDS):
        # Linear in all coefficients, once multiplied by the divisor; the last round's divisor undoes that.
        equations = np.concatenate([block * weight[:, None] for block in blocks])
        found = np.linalg.lstsq(equations, np.concatenate([place[:, i] * weight for i in (0, 1)]), rcond=None)[0]
        under = 1 + divisor @ found[2 * above.shape[1] :]
        under = np.where(np.abs(under) > 1e-6, under, 1e-6)
        weight = used / np.abs(under)
    mapped = np.stack([above @ part for part in np.split(found[: 2 * above.shape[1]], 2)], axis=-1) / under[:, None]
    pull = (np.linalg.qr(equations)[0] ** 2).sum(-1).reshape(2, -1).max(0)
    return mapped * spread + middle, np.asarray(pull)


def _terms(x: FloatArray, y: FloatArray, degree: int) -> FloatArray:
    """Return all powers of x and y up to a degree, (n, k), the constant first."""
    return np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=-1)


def _mended(image: Image, corners: FloatArray, columns: int) -> FloatArray:
    """Return the corners, the few wrong ones of which are found anew where the others say that they are."""
    for _ in range(_MENDINGS):
        used = _trusted(corners, columns)
        if used.all():
            break
        told = np.where(used[:, None], corners, _smooth_map(corners, columns, used)[0])
        corners = _refined(image, told, columns)
    return corners


def _trusted(corners: FloatArray, columns: int) -> BoolArray:
    """Return which corners lie where the others have them, (n,); most do."""
    used, distance = np.ones(len(corners), dtype=np.bool_), _distances(corners, columns)
    for _ in range(len(corners) // _WRONG):
        mapped, pull = _smooth_map(corners, columns, used, _STIFF)
        # Without a corner, the map would be so far off it.
        off = np.linalg.norm(corners - mapped, axis=-1) / np.maximum(1 - pull, _LEAST_FREE)
        doubt = np.where(used, off / np.maximum(_DOUBT * distance, _DOUBT_PX), 0.0)
        if doubt.max() < 1:
            break
        used[int(doubt.argmax())] = False
    return used
