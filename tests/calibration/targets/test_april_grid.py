"""Kalibr's AprilGrid; the truth are the codes of AprilTag's family 36h11, and Kalibr's way to print them."""

import numpy as np
import pytest

from calibration.targets.targets import AprilGrid, TargetError, coverage, patterns

CODES = (0xD5D628584, 0xD97F18B49, 0xDD280910E, 0xE479E9C98, 0xEBCBCA822, 0xF31DAB3AC)
"""The first six of the family: 36 bits, row by row from the upper left, white for one."""


def test_it_is_printed_as_kalibr_does() -> None:
    columns, rows, module, gap = 3, 2, 6, 18
    side = 10 * module
    pitch = side + gap
    picture = np.ones((rows * pitch + gap, columns * pitch + gap))
    for i in range(rows + 1):
        for j in range(columns + 1):
            picture[i * pitch : i * pitch + gap, j * pitch : j * pitch + gap] = 0
    for number, code in enumerate(CODES):
        tag = np.zeros((10, 10))
        tag[2:8, 2:8] = np.reshape([int(bit) for bit in f"{code:036b}"], (6, 6))
        up, across = divmod(number, columns)
        top, left = picture.shape[0] - gap - up * pitch - side, gap + across * pitch
        picture[top : top + side, left : left + side] = np.kron(tag, np.ones((module, module)))
    pattern = patterns(AprilGrid(columns, rows, 0.06, 0.3))[0]
    x, y = (np.linspace(0.5e-3, (count - 0.5) * 1e-3, count) for count in picture.shape[::-1])
    np.testing.assert_allclose(1 - coverage(pattern, x, y, 1e-3), picture, atol=1e-9)
    assert pattern.width == pytest.approx(picture.shape[1] * 1e-3)


@pytest.mark.parametrize(
    "grid",
    [
        AprilGrid(0, 6, 0.088, 0.3),
        AprilGrid(6, 6, -0.088, 0.3),
        AprilGrid(6, 6, 0.088, 30.0),
        AprilGrid(30, 30, 0.088, 0.3),
    ],
)
def test_a_grid_that_cannot_be_is_refused(grid: AprilGrid) -> None:
    with pytest.raises(TargetError, match="needs"):
        patterns(grid)
