import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc.cameras import DoubleSphere, Eucm, KannalaBrandt, Mei, Pinhole, RationalPinhole
from palletloc.cameras.derivatives import (
    PlaneImage,
    double_sphere_image,
    eucm_image,
    kannala_brandt_image,
    mei_image,
    pinhole_image,
    rational_pinhole_image,
)
from palletloc.cameras.lens import Lens
from palletloc.cameras.odd_polynomial import OddPolynomial
from palletloc.cameras.odd_rational import OddRational
from palletloc.geometry import FloatArray
from tests.palletloc.cameras.sample_cameras import RATIONAL_TERMS

# With a slope that almost vanishes on the way (at x = 1.05), so that plain Newton steps fly off.
FLAT_ON_THE_WAY = OddPolynomial((-0.6, 0.164))
POLYNOMIALS = {
    "identity": OddPolynomial(()),
    "no_distortion": OddPolynomial((0.0, 0.0, 0.0)),
    "flat_on_the_way": FLAT_ON_THE_WAY,
    "barrel": OddPolynomial((-0.2, 0.05, -0.01)),
    "steep": OddPolynomial((0.5, 2.0, 4.0)),
    "up_to_the_turn": OddPolynomial((-1 / 3,)),
}
every_polynomial = pytest.mark.parametrize("polynomial", POLYNOMIALS.values(), ids=POLYNOMIALS.keys())


def by_definition(polynomial: OddPolynomial, x: FloatArray) -> FloatArray:
    return np.asarray(x + sum(c * x ** (2 * i + 3) for i, c in enumerate(polynomial.coefficients)))


@every_polynomial
def test_factor_and_slope_follow_the_definition(polynomial: OddPolynomial) -> None:
    x = np.linspace(0.01, 2.0, 50)
    np.testing.assert_allclose(x * polynomial.factor(x * x), by_definition(polynomial, x), rtol=1e-12)
    step = 1e-6
    slope = (by_definition(polynomial, x + step) - by_definition(polynomial, x - step)) / (2 * step)
    np.testing.assert_allclose(polynomial.slope(x * x), slope, rtol=1e-6, atol=1e-7)


@every_polynomial
def test_inverse_undoes_the_polynomial(polynomial: OddPolynomial) -> None:
    upper = polynomial.increasing_until()
    values = by_definition(polynomial, np.linspace(0.0, min(upper, 3.0), 5001))
    found = polynomial.inverse(values, upper)
    np.testing.assert_allclose(by_definition(polynomial, found), values, rtol=1e-14, atol=1e-15)
    assert found.min() >= 0
    assert found.max() <= upper


def test_inverse_is_exact_where_the_slope_almost_vanishes_and_none_beyond_the_reach_nor_of_nan() -> None:
    x = np.linspace(0.0, 2.0, 5001)
    found = FLAT_ON_THE_WAY.inverse(by_definition(FLAT_ON_THE_WAY, x), 2.0)
    np.testing.assert_allclose(found, x, atol=1e-12)
    turn = POLYNOMIALS["up_to_the_turn"]
    found = turn.inverse(np.array([[0.1, 0.6], [2 / 3 + 1e-9, np.nan]]), turn.increasing_until())
    np.testing.assert_array_equal(np.isnan(found), [[False, False], [True, True]])


@given(st.lists(st.floats(-1.0, 1.0), max_size=4), st.floats(0.0, 0.5))
def test_it_rises_as_far_as_stated_and_no_farther(coefficients: list[float], margin: float) -> None:
    polynomial = OddPolynomial(tuple(coefficients))
    end = polynomial.increasing_until(margin)
    x = np.linspace(0.0, min(0.999 * end, 50.0), 1000)
    slope = polynomial.slope(x * x)
    assert (slope - margin * x).min() > -1e-9 * np.abs(slope).max()
    if math.isfinite(end):
        after = np.array([end * (1 + 1e-6)])
        lowest = min(float(polynomial.slope(after**2)[0]), float(polynomial.factor(after**2)[0]))
        assert lowest - margin * after[0] < 1e-4


@given(st.lists(st.floats(-1.0, 1.0), max_size=3), st.lists(st.floats(-1.0, 1.0), max_size=3), st.floats(0.0, 0.5))
def test_a_quotient_rises_as_far_as_stated_and_no_farther(
    above: list[float], below: list[float], margin: float
) -> None:
    quotient = OddRational(tuple(above), tuple(below))
    end = quotient.increasing_until(margin)
    x = np.linspace(0.0, min(0.999 * end, 50.0), 1000)
    slope, under = quotient.slope(x * x), OddPolynomial(tuple(below)).factor(x * x)
    assert under.min() > 0
    assert (slope - margin * x).min() > -1e-9 * np.abs(slope).max()
    if math.isfinite(end):
        after = np.array([end * (1 + 1e-6)])
        ends = [quotient.slope(after**2)[0], quotient.factor(after**2)[0]]
        pole = float(OddPolynomial(tuple(below)).factor(after**2)[0])
        assert min(*ends, 1e-3) - margin * after[0] < 1e-3 or pole < 1e-4
    inverse = quotient.inverse(x * quotient.factor(x * x), end)
    np.testing.assert_allclose(inverse, x, rtol=1e-6, atol=1e-6)


def test_a_quotient_by_one_is_the_polynomial() -> None:
    squared = np.linspace(0.0, 1.0, 11)
    terms = (-0.28, 0.09, -0.012)
    np.testing.assert_array_equal(OddRational(terms, ()).factor(squared), OddPolynomial(terms).factor(squared))
    np.testing.assert_allclose(OddRational(terms, ()).slope(squared), OddPolynomial(terms).slope(squared), atol=1e-15)
    assert OddRational(terms, ()).increasing_until() == pytest.approx(
        OddPolynomial(terms).increasing_until(), rel=1e-8
    )


Imaged = Callable[[FloatArray, FloatArray], PlaneImage]
SIZE = (1200, 1000, 300.0, 304.0, 601.0, 497.0)
LENSES: dict[str, tuple[Lens, Imaged, tuple[float, ...]]] = {
    "kannala_brandt": (
        KannalaBrandt(*SIZE, 0.03, -0.012, 0.002, -0.0002, 1.9),
        kannala_brandt_image,
        (0.03, -0.012, 0.002, -0.0002),
    ),
    "mei": (Mei(*SIZE, 1.05, -0.01, 0.01, 0.02, -0.004, 1.8), mei_image, (1.05, -0.01, 0.01, 0.02, -0.004)),
    "double_sphere": (DoubleSphere(*SIZE, -0.24, 0.566, 1.8), double_sphere_image, (-0.24, 0.566)),
    "eucm": (Eucm(*SIZE, 0.586, 1.139, 1.8), eucm_image, (0.586, 1.139)),
    "pinhole": (
        Pinhole(*SIZE, -0.28, 0.09, 0.002, -0.0015, -0.012),
        pinhole_image,
        (-0.28, 0.09, 0.002, -0.0015, -0.012),
    ),
    "rational_pinhole": (RationalPinhole(*SIZE, *RATIONAL_TERMS), rational_pinhole_image, RATIONAL_TERMS),
}
every_lens = pytest.mark.parametrize("name", LENSES)


def rays_of(lens: Lens) -> tuple[FloatArray, FloatArray]:
    """Return pixels, and their rays: right, down, forward, of several lengths."""
    u, v = np.meshgrid(np.arange(3.0, lens.width, 83.0), np.arange(2.0, lens.height, 71.0))
    pixels = np.stack([u, v], axis=-1).reshape(-1, 2)
    directions, _, valid = lens.unproject(pixels)
    rays = np.stack([-directions[:, 1], -directions[:, 2], directions[:, 0]], axis=-1)
    return pixels[valid], rays[valid] * np.linspace(0.5, 3.0, int(valid.sum()))[:, None]


@every_lens
def test_the_image_is_the_camera_s(name: str) -> None:
    lens, image, shape = LENSES[name]
    pixels, rays = rays_of(lens)
    assert len(rays) > 50
    points = image(rays, np.array(shape)).points
    np.testing.assert_allclose(points * (lens.fx, lens.fy) + (lens.cx, lens.cy), pixels, atol=1e-9)


@every_lens
def test_derivatives_are_those_of_finite_differences(name: str) -> None:
    lens, image, values = LENSES[name]
    rays, shape = rays_of(lens)[1], np.array(values)
    found = image(rays, shape)
    for i, unit in enumerate(np.eye(len(shape))):
        ends = [image(rays, shape + sign * 1e-6 * unit).points for sign in (1, -1)]
        np.testing.assert_allclose(found.by_shape[:, :, i], (ends[0] - ends[1]) / 2e-6, rtol=1e-5, atol=1e-6)
    for i, unit in enumerate(np.eye(3)):
        ends = [image(rays + sign * 1e-6 * unit, shape).points for sign in (1, -1)]
        np.testing.assert_allclose(found.by_ray[:, :, i], (ends[0] - ends[1]) / 2e-6, rtol=1e-5, atol=1e-6)


@every_lens
def test_the_axis_has_derivatives_too(name: str) -> None:
    _, image, shape = LENSES[name]
    on_axis = image(np.array([[0.0, 0.0, 2.0]]), np.array(shape))
    beside = image(np.array([[1e-5, -1e-5, 2.0]]), np.array(shape))
    np.testing.assert_allclose(on_axis.points, 0.0, atol=1e-12)
    np.testing.assert_allclose(on_axis.by_ray, beside.by_ray, atol=1e-4)
    assert np.isfinite(on_axis.by_shape).all()


@pytest.mark.parametrize(
    ("image", "shape"),
    [
        (mei_image, (0.5, 0, 0, 0, 0)),
        (double_sphere_image, (0.1, 0.4)),
        (eucm_image, (0.3, 1.0)),
        (pinhole_image, (0.0,) * 5),
    ],
)
def test_where_there_is_no_image_there_is_no_number(image: Imaged, shape: tuple[float, ...]) -> None:
    assert np.isnan(image(np.array([[-0.01, 0.0, -1.0]]), np.array(shape)).points).all()
