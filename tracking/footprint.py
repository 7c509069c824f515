"""Which tracks and measurements are in each other's place."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palletloc.footprint import outline, overlaps
from palletloc.geometry import BoolArray, FloatArray
from palletloc.pallet import PalletModel
from palletloc.pallet_library import load_library

IndexArray = NDArray[np.intp]
"""Indices."""
UNSURE = 3.0
"""Standard deviations by which heights may be off."""


class Standing(NamedTuple):
    """A pallet that stands somewhere."""

    pose: FloatArray
    """(4,) x, y, z and yaw, in metres and radians."""
    covariance: FloatArray
    """(4, 4) or larger: its covariance."""
    model: str
    """Name of the pallet model."""


class Footprints:
    """Sizes of the pallets that may be measured.

    Parameters
    ----------
    models : iterable of PalletModel, optional
        The pallets of the site: others are rejected. If left out, the library's sizes are used and any name is
        taken.
    """

    def __init__(self, models: Iterable[PalletModel] | None = None) -> None:
        self._strict = models is not None
        self._models = load_library() if models is None else {model.name: model for model in models}
        self._outlines = {name: outline(model) for name, model in self._models.items()}
        self._smallest = outline(min(load_library().values(), key=lambda model: model.width))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the known models."""
        return tuple(self._models)

    def accepts(self, model: str) -> bool:
        """Tell whether measurements of a model are taken."""
        return not self._strict or model in self._models

    def same_place(self, one: Standing, others: Sequence[Standing]) -> BoolArray:
        """Tell which pallets would stand in another one: at most one of them is there.

        Parameters
        ----------
        one : Standing
            A pallet.
        others : sequence of Standing
            The others.

        Returns
        -------
        (n,) array of bool
            Whether it stands in each of them.
        """
        poses, outlines, variances = self._stacked((one, *others))
        return _overlap(poses, outlines, variances, np.zeros(len(others), dtype=np.intp), np.arange(len(others)) + 1)

    def sharing(self, pallets: Sequence[Standing]) -> list[tuple[int, int]]:
        """Return the pairs of pallets that stand in each other."""
        if len(pallets) < 2:
            return []
        poses, outlines, variances = self._stacked(pallets)
        width, height, depth = outlines.max(axis=0)
        floor, heights = poses[:, :2], poses[:, 2]
        squares = (floor * floor).sum(axis=1)
        apart = squares[:, None] + squares - 2 * floor @ floor.T
        reach = height + UNSURE * math.sqrt(2 * variances.max())
        near = (apart < 1.001 * (width**2 + depth**2)) & (np.abs(heights[:, None] - heights) < reach)
        one, two = np.nonzero(np.triu(near, 1))
        found = _overlap(poses, outlines, variances, one, two)
        return list(zip(one[found].tolist(), two[found].tolist(), strict=True))

    def _stacked(self, pallets: Sequence[Standing]) -> tuple[FloatArray, FloatArray, FloatArray]:
        poses = np.array([one.pose for one in pallets])
        models = [one.model for one in pallets]
        outlines = np.array([self._outlines.get(model, self._smallest) for model in dict.fromkeys(models)])
        if len(outlines) > 1:
            outlines = np.array([self._outlines.get(model, self._smallest) for model in models])
        outlines = np.broadcast_to(outlines, (len(models), 3))
        return poses, outlines, np.array([one.covariance[2, 2] for one in pallets])


def _overlap(
    poses: FloatArray, outlines: FloatArray, variances: FloatArray, one: IndexArray, two: IndexArray
) -> BoolArray:
    """Tell which pairs stand in each other at heights that are as alike as they may be.

    A pallet is low: an error of a few centimetres would put one above itself.
    """
    others = poses[two]
    up = others[:, 2] - poses[one, 2]
    unsure = UNSURE * np.sqrt(variances[one] + variances[two])
    others[:, 2] = poses[one, 2] + np.sign(up) * np.maximum(np.abs(up) - unsure, 0.0)
    # seen from either of them: they may be turned against each other
    first = overlaps(poses[one], outlines[one], others, outlines[two])
    return first | overlaps(others, outlines[two], poses[one], outlines[one])
