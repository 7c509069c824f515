from collections.abc import Callable, Sequence

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

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
def open_below() -> PalletModel:
    """A face with sharp edges whose openings reach the floor."""
    openings = tuple(Opening(center, 0.0, 0.2275, 0.1) for center in (-0.186, 0.186))
    return PalletModel("open", 0.8, 0.144, 1.2, openings)


@pytest.fixture
def rounded() -> PalletModel:
    """A face with rounded corners and edges."""
    openings = tuple(Opening(center, 0.024, 0.29, 0.092, 0.012) for center in (-0.265, 0.265))
    return PalletModel("rounded", 1.1, 0.144, 1.1, openings, 0.012, 0.010)


@pytest.fixture
def hall() -> Callable[[Sequence[Solid]], Scene]:
    """Return a function that puts solids into a plain white hall."""

    def scene(solids: Sequence[Solid]) -> Scene:
        return Scene(Room((-9.0, -9.0), (9.0, 9.0), 6.0, WHITE, WHITE, WHITE), OVERHEAD, tuple(solids))

    return scene


@pytest.fixture
def looking() -> Callable[..., RigidTransform]:
    """Return a function that places a camera: where it is, and yaw, pitch and roll in degrees."""

    def world_from_camera(position: Sequence[float], *angles_deg: float) -> RigidTransform:
        angles = (*angles_deg, 0.0, 0.0, 0.0)[:3]
        return RigidTransform.from_components(np.array(position), Rotation.from_euler("ZYX", angles, degrees=True))

    return world_from_camera
