from collections.abc import Callable, Sequence

import pytest

from palletloc.pallet import Opening, PalletModel
from palletloc.synthetic.scene import Light, Material, Room, Scene, Solid

BLACK, WHITE = Material((0.0, 0.0, 0.0)), Material((0.8, 0.8, 0.8))
OVERHEAD = Light(((0.0, 0.6, 0.8), (0.6, 0.0, 0.8), (-0.6, 0.0, 0.8), (0.0, -0.6, 0.8)), (0.3,) * 4, sharp=4)


@pytest.fixture
def closed_below() -> PalletModel:
    """A face with sharp edges whose openings have a board below them."""
    openings = tuple(Opening(center, 0.022, 0.38, 0.1) for center in (-0.264, 0.25))
    return PalletModel("closed", 1.2, 0.144, 0.8, openings)


@pytest.fixture
def hall() -> Callable[[Sequence[Solid]], Scene]:
    """Return a function that puts solids into a plain white hall."""

    def scene(solids: Sequence[Solid]) -> Scene:
        return Scene(Room((-9.0, -9.0), (9.0, 9.0), 6.0, WHITE, WHITE, WHITE), OVERHEAD, tuple(solids))

    return scene
