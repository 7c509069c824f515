"""OCamCalib's text: a polynomial from the radius in the image to the depth of the ray, and one back.

D. Scaramuzza, A. Martinelli, R. Siegwart, "A toolbox for easily calibrating omnidirectional cameras", IROS 2006.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.formats.camera_file import FiledCamera, alone
from calibration.formats.fields import LARGEST, Fields, FormatError
from calibration.formats.syntax import TABLE
from palletloc.cameras import KannalaBrandt, Projection, Rays
from palletloc.cameras.image_area import blank_invalid, inside_image
from palletloc.geometry import FloatArray
from palletloc.io.images import MAX_SIDE_PX

MODELS = ("kannala_brandt",)
"""What the format can hold."""
_MOST_TERMS, _GOOD_PX = 16, 0.01
"""Degree of a polynomial at most, and the error in pixels at which it is good: far below that of any corner."""
_SAMPLES = 2000
"""Angles that polynomials are fitted at: many more than they have terms."""


@dataclass(frozen=True, slots=True, eq=False)
class OcamCamera:
    """A camera by OCamCalib's two polynomials."""

    width: int
    """Image width in pixels."""
    height: int
    """Image height in pixels."""
    forward: tuple[float, ...]
    """Depth of the ray, negative ahead, as a polynomial of the radius; lowest power first."""
    inverse: tuple[float, ...]
    """Radius as a polynomial of the ray's angle above the plane across the axis; lowest power first."""
    cx: float
    """Column of the axis."""
    cy: float
    """Row of the axis."""
    stretch: tuple[float, float, float]
    """c, d, e: row = c x + d y, column = e x + y."""

    @property
    def period_px(self) -> float | None:
        """The image does not close around."""
        return None

    @property
    def max_radius(self) -> float:
        """How far from the axis the image shows something: to its farthest side, in pixels."""
        return max(self.cx, self.cy, self.width - 1 - self.cx, self.height - 1 - self.cy)

    def project(self, points_camera: FloatArray) -> Projection:
        """Project points to pixels. See `CameraModel.project`."""
        points = np.asarray(points_camera, dtype=np.float64)
        down, right, ahead = -points[..., 2], -points[..., 1], points[..., 0]
        across = np.hypot(down, right)
        with np.errstate(invalid="ignore", divide="ignore"):
            radius = np.polyval(self.inverse[::-1], np.arctan2(-ahead, across))
            scale = np.where(across > 0, radius / across, 0.0)
            x, y = scale * down, scale * right
            c, d, e = self.stretch
            pixels = np.stack([e * x + y + self.cx, c * x + d * y + self.cy], axis=-1)
        valid = (across > 0) | (ahead > 0)
        valid &= (radius <= self.max_radius) & inside_image(pixels, self.width, self.height)
        blank_invalid(pixels, valid)
        return Projection(pixels, valid)

    def unproject(self, pixels: FloatArray) -> Rays:
        """Return the rays that pixels look along. See `CameraModel.unproject`."""
        pixels = np.asarray(pixels, dtype=np.float64)
        c, d, e = self.stretch
        row, column = pixels[..., 1] - self.cy, pixels[..., 0] - self.cx
        x, y = (row - d * column) / (c - d * e), (c * column - e * row) / (c - d * e)
        radius = np.hypot(x, y)
        depth = np.polyval(self.forward[::-1], radius)
        directions = np.stack([-depth, -y, -x], axis=-1)
        with np.errstate(invalid="ignore", divide="ignore"):
            directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        valid = inside_image(pixels, self.width, self.height) & (radius <= self.max_radius)
        blank_invalid(directions, valid)
        return Rays(directions, np.zeros_like(directions), valid)

    def centers(self, points_camera: FloatArray) -> FloatArray:
        """Return the optical centre, the origin, for each point. See `CameraModel.centers`."""
        return np.zeros(np.shape(points_camera))


def read_ocam(fields: Fields) -> list[FiledCamera]:
    """Return the camera of a file of OCamCalib; argument and errors as for `read_basalt`, with the line."""
    path = fields.path
    lines = [(row["line"], row["words"]) for row in fields.at(TABLE).value]
    if len(lines) < 5:
        raise FormatError(
            f"{path}: expected 5 lines of numbers (polynomials, centre, stretch, size), got {len(lines)}"
            " (a table of numbers is taken for a file of OCamCalib)"
        )
    forward, inverse = (_polynomial(path, *line) for line in lines[:2])
    cy, cx = _numbers(path, *lines[2], 2)
    stretch = _numbers(path, *lines[3], 3)
    height, width = _numbers(path, *lines[4], 2)
    if not all(side == int(side) and 0 < side <= MAX_SIDE_PX for side in (width, height)):
        raise FormatError(
            f"{path}, line {lines[4][0]}: expected height and width in whole pixels, up to {MAX_SIDE_PX}"
        )
    camera = OcamCamera(int(width), int(height), forward, inverse, cx, cy, (stretch[0], stretch[1], stretch[2]))
    return [alone("camera", _checked(camera, *(f"{path}, line {lines[i][0]}" for i in (2, 0))))]


def _checked(camera: OcamCamera, center: str, polynomial: str) -> OcamCamera:
    """Return a camera that can be one; an error begins with the place of what is wrong."""
    c, d, e = camera.stretch
    if not (0 <= camera.cx < camera.width and 0 <= camera.cy < camera.height and abs(c - d * e) > 0.1):
        raise FormatError(f"{center}: expected a centre in the image, and a stretch near 1, 0, 0")
    if not camera.forward[0] < 0:
        raise FormatError(f"{polynomial}: expected a negative first coefficient, got {camera.forward[0]:g}")
    return camera


def camodocal_ocam(fields: Fields, size: tuple[int, int]) -> OcamCamera:
    """Return the camera of a file of CamOdoCal with the model SCARAMUZZA.

    There, column = ac x + ad y + cx and row = ae x + y + cy, with x to the right and y down.

    Parameters
    ----------
    fields : Fields
        The whole file.
    size : (int, int)
        Width and height of the image, in pixels.

    Raises
    ------
    FormatError
        If it does not hold what the format says.
    """
    forward, inverse = (
        [given.at(f"p{i}").number() for i in range(len(given.value))]
        for given in (fields.at("poly_parameters"), fields.at("inv_poly_parameters"))
    )
    affine = fields.at("affine_parameters")
    ac, ad, ae, cx, cy = (affine.at(key).number() for key in ("ac", "ad", "ae", "cx", "cy"))
    if not ac > 0 or len(forward) < 3:
        raise fields.wrong("expected three coefficients at least, and affine_parameters with ac near 1")
    # Ours stretches rows, not columns: all lengths in the plane grow by ac.
    camera = OcamCamera(
        *size,
        tuple(term * ac ** (1 - i) for i, term in enumerate(forward)),
        tuple(term * ac for term in inverse),
        cx,
        cy,
        (1 / ac, ae / ac, ad / ac),
    )
    return _checked(camera, f"{fields.path}: affine_parameters", f"{fields.path}: poly_parameters")


def _polynomial(path: Path, number: int, line: list[str]) -> tuple[float, ...]:
    values = _numbers(path, number, line)
    if values[0] != len(values) - 1 or len(values) < 3:
        raise FormatError(
            f"{path}, line {number}: expected a count and as many coefficients, got {len(values)} numbers"
        )
    return values[1:]


def _numbers(path: Path, number: int, line: list[str], count: int | None = None) -> tuple[float, ...]:
    try:
        values = tuple(float(word) for word in line)
    except ValueError:
        values = (np.nan,)
    if not (np.abs(values) <= LARGEST).all() or (count is not None and len(values) != count):
        raise FormatError(f"{path}, line {number}: expected {'' if count is None else f'{count} '}finite numbers")
    return values


def ocam_camera(lens: KannalaBrandt) -> OcamCamera:
    """Return the OCamCalib camera that images like a lens; beyond its largest angle the polynomials mean nothing."""
    angle = np.linspace(1e-4, lens.max_angle, _SAMPLES)
    radius = lens.fx * (angle + (angle[:, None] ** np.array([3, 5, 7, 9])) @ [lens.k1, lens.k2, lens.k3, lens.k4])
    for degree in range(4, _MOST_TERMS):
        forward, off = _forward_polynomial(angle, radius, degree)
        if lens.fx * off < _GOOD_PX:
            break
    above = angle - np.pi / 2
    for terms in range(4, _MOST_TERMS):
        inverse = np.polynomial.Polynomial.fit(above, radius, terms).convert().coef
        if np.abs(np.polynomial.polynomial.polyval(above, inverse) - radius).max() < _GOOD_PX:
            break
    return OcamCamera(
        lens.width, lens.height, tuple(forward.tolist()), tuple(inverse.tolist()), lens.cx, lens.cy,
        (lens.fy / lens.fx, 0.0, 0.0),
    )  # fmt: skip


def _forward_polynomial(angle: FloatArray, radius: FloatArray, degree: int) -> tuple[FloatArray, float]:
    """Return the depth over the radius, without a linear term as the format wants it, and its largest error."""
    powers = np.array([0, *range(2, degree + 1)])
    scale = float(radius[-1])
    # Across the ray: depth + radius / tan(angle) = 0, weighted so that errors are angles.
    weight = np.sin(angle) / radius
    terms = (radius[:, None] / scale) ** powers * weight[:, None]
    solved = np.linalg.lstsq(terms, -np.cos(angle), rcond=None)[0]
    forward = np.zeros(degree + 1)
    forward[powers] = solved / scale**powers
    return forward, float(np.abs(terms @ solved + np.cos(angle)).max())


def ocam_text(camera: OcamCamera) -> str:
    """Return the text of OCamCalib."""

    def row(values: tuple[float, ...]) -> str:
        return " ".join(f"{value:.15g}" for value in values)

    return (
        "#polynomial coefficients for the DIRECT mapping function (ocam_model.ss in MATLAB)\n\n"
        f"{len(camera.forward)} {row(camera.forward)}\n\n"
        "#polynomial coefficients for the inverse mapping function (ocam_model.invpol in MATLAB)\n\n"
        f"{len(camera.inverse)} {row(camera.inverse)}\n\n"
        '#center: "row" and "column", starting from 0 (C convention)\n\n'
        f"{row((camera.cy, camera.cx))}\n\n"
        '#affine parameters "c", "d", "e"\n\n'
        f"{row(camera.stretch)}\n\n"
        '#image size: "height" and "width"\n\n'
        f"{camera.height} {camera.width}\n"
    )
