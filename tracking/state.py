"""The state of one pallet.

It is the pallet's pose in the forklift frame with what errs alike in many steps:

====== =========================================================================================
0 - 3  x, y, z in metres and yaw in radians: ``forklift_from_pallet``
4      the wheels' relative scale error
5      the rate that the gyroscope misses, in rad/s
6 - 9  the error that this pallet's measurements share, in units of its standard deviation
====== =========================================================================================
"""

from __future__ import annotations

from typing import NamedTuple

from palletloc.geometry import FloatArray

SIZE = 10
"""Numbers in the state."""
POSE, CONSTANTS, COMMON = slice(0, 4), slice(4, 6), slice(6, 10)
"""Where its parts are."""
DIAGONAL = slice(None, None, SIZE + 1)
"""The diagonal of its covariance, row by row."""


class Gaussian(NamedTuple):
    """What is known of a state."""

    mean: FloatArray
    """(10,) the state."""
    covariance: FloatArray
    """(10, 10) its covariance."""
