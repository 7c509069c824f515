"""Which tracks and measurements are in each other's place."""

from __future__ import annotations

from collections.abc import Iterable

from palletloc.geometry import LevelPose
from palletloc.pallet import PalletModel
from palletloc.pallet_library import load_library
from palletloc.verification import overlapping


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
        self._smallest = min(load_library().values(), key=lambda model: model.width)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the known models."""
        return tuple(self._models)

    def accepts(self, model: str) -> bool:
        """Tell whether measurements of a model are taken."""
        return not self._strict or model in self._models

    def same_place(self, pose: LevelPose, model: str, other: LevelPose, other_model: str) -> bool:
        """Tell whether two pallets would stand in each other: at most one of them is there."""
        one, two = (self._models.get(name, self._smallest) for name in (model, other_model))
        return overlapping(pose, one, other, two)
