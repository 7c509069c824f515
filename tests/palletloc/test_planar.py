import numpy as np
import pytest

from palletloc.planar import compose, quarter, relative, relative_slopes, turned

RNG = np.random.default_rng(1)
POSES, OTHERS = RNG.uniform(-3, 3, (2, 20, 3))


def test_relative_is_the_inverse_of_compose() -> None:
    steps = relative(POSES, OTHERS)
    np.testing.assert_allclose(relative(POSES, compose(POSES, steps)), steps, atol=1e-12)
    np.testing.assert_allclose(compose(POSES, steps)[:, :2], OTHERS[:, :2], atol=1e-12)


@pytest.mark.parametrize("which", [0, 1])
def test_slopes_are_those_of_small_changes(which: int) -> None:
    slopes = relative_slopes(POSES, OTHERS)[which]
    for column in range(3):
        step = 1e-6 * np.eye(3)[column]
        ends = [relative(POSES + sign * step * (which == 0), OTHERS + sign * step * (which == 1)) for sign in (1, -1)]
        change = ends[0] - ends[1]
        change[:, 2] = (change[:, 2] + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(slopes[:, :, column], change / 2e-6, atol=1e-8)


def test_a_quarter_is_a_turn_by_a_right_angle() -> None:
    np.testing.assert_allclose(turned(POSES[:, :2], np.full(20, np.pi / 2)), quarter(POSES[:, :2]), atol=1e-12)
