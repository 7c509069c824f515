"""What bad input is tried on, and its law: a refusal or a right pose, never a confident wrong row."""

import inspect
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from palletloc import Explanation, LevelPose, Localizer, Method, PalletMeasurement, PalletModel, ShelfPlane, Shot
from palletloc.choices import CameraKind
from palletloc.geometry import wrap_angle
from palletloc.methods import METHODS
from palletloc.synthetic.rig import camera_of
from tests.palletloc.bad_input.drawn import Scene
from tests.palletloc.poses import Pallets, Photograph, Placed

RIGHT = -np.pi / 2
"""Heading into a shelf on the right."""
MAX_ERROR, MAX_TURN = 0.06, float(np.radians(1.5))
MAX_SIGMAS = 5.0
NO_PALLET = 0.5
"""From which distance to the nearest pallet on a row stands where none is, in metres."""
CARELESS = {Method.PAPER, Method.JOINT_SEARCH}
"""Baselines: they do not verify what they find."""
DEFAULT: Method = inspect.signature(Localizer).parameters["method"].default


def _methods() -> list[object]:
    others = [method for method in METHODS if method not in {DEFAULT, *CARELESS}]
    return [DEFAULT, *(pytest.param(method, marks=pytest.mark.slow) for method in others)]


@pytest.fixture(scope="session", params=_methods(), ids=str)
def method(request: pytest.FixtureRequest) -> Method:
    """Return a method that verifies what it finds: the default one, and with the slow tests every other."""
    return Method(request.param)


def _fault(row: PalletMeasurement, pallets: Sequence[Placed]) -> str:
    """Return what is wrong with a row; nothing where it is right, or where its covariance says how wrong it is."""
    pose, tried = row.forklift_from_pallet, []
    for _, truth in pallets:
        error = pose.as_array() - truth.as_array()
        error[3] = wrap_angle(error[3])
        right = np.abs(error[:3]).max() <= MAX_ERROR and abs(error[3]) <= MAX_TURN
        away, sigmas = np.linalg.norm(error[:3]), np.sqrt(error @ np.linalg.solve(row.covariance, error))
        if right or (away <= NO_PALLET and sigmas <= MAX_SIGMAS):
            return ""
        tried.append((float(away), float(sigmas), np.round(1e3 * error).tolist()))
    return f"{row.model} at {pose}; nearest pallet (distance, sigmas, error in mm and mrad): {min(tried, default=())}"


@pytest.fixture(scope="session")
def faults() -> Callable[[Explanation, Sequence[Placed]], list[str]]:
    """Return a function that returns what is wrong with the rows of a shot that shows some pallets."""

    def found(explained: Explanation, pallets: Sequence[Placed] = ()) -> list[str]:
        answered = len(explained.measurements) + len(explained.refusals)
        lost = [] if answered == len(explained.outcomes) else ["a candidate is neither a row nor refused"]
        return lost + [text for text in (_fault(row, pallets) for row in explained.measurements) if text]

    return found


@pytest.fixture(scope="session")
def localizer(method: Method) -> Callable[..., Localizer]:
    """Return a function that makes a localizer for pallets."""

    def made(pallets: Sequence[Placed]) -> Localizer:
        return Localizer([model for model, _ in pallets], method)

    return made


@pytest.fixture(scope="session")
def right_pallets(epal: PalletModel, t11: PalletModel) -> Pallets:
    """Return two pallets on the floor to the right."""
    return (
        (t11, LevelPose(0.7, -1.9, 0.0, RIGHT + np.radians(2.0))),
        (epal, LevelPose(2.2, -1.93, 0.0, RIGHT - np.radians(1.0))),
    )


@pytest.fixture(scope="session")
def scenes(
    photograph: Photograph,
    floor_shot: Shot,
    floor_pallets: Pallets,
    rack_shot: Shot,
    rack_pallets: Pallets,
    right_pallets: Pallets,
) -> Callable[[str], Scene]:
    """Return a function that returns a scene by its name: a shot, the pallets in it and the nominal shelf plane."""
    right = ShelfPlane(1.4, -1.9, np.pi / 2 + 0.01, (0.0,))

    def scene(name: str) -> Scene:
        if name == "floor":
            return floor_shot, floor_pallets, ShelfPlane(1.3, 2.02, -np.pi / 2 + 0.01, (0.0,))
        if name == "rack":
            return rack_shot, rack_pallets, ShelfPlane(1.0, 1.98, -np.pi / 2 - 0.01, (0.0, 1.23, 2.4))
        kind, width = {"fisheye": (CameraKind.KANNALA_BRANDT, 900), "pinhole": (CameraKind.PINHOLE, 640)}[name]
        placed = (0.2, 0.05, 1.7, -58.0, 20.0, 0.5)
        return photograph(right_pallets, camera_of(kind, width), placed, seed=3), right_pallets, right

    return scene
