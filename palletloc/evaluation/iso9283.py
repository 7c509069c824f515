"""Accuracy and repeatability of poses at one stop, in the terms of ISO 9283 (industrial robots)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palletloc.geometry import FloatArray, wrap_angle


@dataclass(frozen=True, slots=True, eq=False)
class StopAccuracy:
    r"""How well a pose is met at one stop, over n repetitions.

    With the positions :math:`p_j` met, the commanded one :math:`p_c` (here: the truth) and the barycentre
    :math:`\bar p = \frac{1}{n} \sum p_j`:

    .. math::

        AP_p &= \lVert \bar p - p_c \rVert, \qquad
        RP = \bar l + 3 S_l, \qquad l_j = \lVert p_j - \bar p \rVert \\
        AP_c &= \bar c - c_c, \qquad RP_c = 3 S_c

    with :math:`\bar l` the mean of the :math:`l_j`, :math:`c` the yaw, and standard deviations
    :math:`S_l`, :math:`S_c` with n - 1 in the denominator. The standard asks for 30 repetitions.
    """

    n: int
    """Number of repetitions."""
    mean: FloatArray
    """(3,) barycentre minus the true position, in metres, in the axes of the positions given."""
    ap: float
    """Accuracy of the position :math:`AP_p`, in metres: 0 or more."""
    rp: float
    """Repeatability of the position :math:`RP`, in metres; NaN for a single repetition."""
    ap_yaw: float
    """Accuracy of the yaw :math:`AP_c`, in radians, with its sign."""
    rp_yaw: float
    """Repeatability of the yaw :math:`RP_c`, in radians, to be read as plus or minus; NaN for a single one."""


def stop_accuracy(offsets: FloatArray) -> StopAccuracy:
    """Return accuracy and repeatability of the poses met at one stop.

    Parameters
    ----------
    offsets : (n, 4) array
        Errors of three coordinates in metres, in axes that are the same for all of them, and of the yaw in
        radians: estimate minus truth. Where the truth of a stop is one pose, differences of errors are
        differences of estimates, so the repeatability is that of the estimates.

    Returns
    -------
    StopAccuracy
        Of that stop.

    Raises
    ------
    ValueError
        If there is no repetition or the shape does not fit.

    Examples
    --------
    >>> stop = stop_accuracy(np.array([[0.01, 0, 0, 0.02], [0.03, 0, 0, 0.02]]))
    >>> round(stop.ap, 6), round(stop.rp, 6), round(stop.ap_yaw, 6), round(stop.rp_yaw, 6)
    (0.02, 0.01, 0.02, 0.0)
    """
    offsets = np.asarray(offsets, dtype=np.float64)
    if offsets.ndim != 2 or offsets.shape[1] != 4 or not len(offsets):
        raise ValueError(f"offsets: expected (n, 4) with n at least 1, got {offsets.shape}")
    positions, yaw = offsets[:, :3], offsets[:, 3]
    mean = positions.mean(axis=0)
    distance = np.linalg.norm(positions - mean, axis=1)
    # about their direction, so that errors near half a turn do not cancel
    direction = float(np.angle(np.exp(1j * yaw).sum()))
    beside = wrap_angle(yaw - direction)
    return StopAccuracy(
        n=len(offsets),
        mean=mean,
        ap=float(np.linalg.norm(mean)),
        rp=float(distance.mean()) + 3 * _deviation(distance),
        ap_yaw=wrap_angle(direction + float(beside.mean())),
        rp_yaw=3 * _deviation(beside),
    )


def _deviation(values: FloatArray) -> float:
    return float(values.std(ddof=1)) if len(values) > 1 else float("nan")
