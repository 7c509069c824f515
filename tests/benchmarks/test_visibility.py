from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from benchmarks.visibility import face_points, hidden_share
from palletloc.cameras import CameraModel, Equirectangular
from palletloc.choices import CameraKind
from palletloc.geometry import LevelPose
from palletloc.pallet import PalletModel
from palletloc.pallet_library import load_library
from palletloc.synthetic.pallet_solid import PalletBody
from palletloc.synthetic.rays import camera_rays
from palletloc.synthetic.rendering import lit, render
from palletloc.synthetic.rig import camera_of
from palletloc.synthetic.scene import Box, Light, Material, Room, Scene, Solid

EPAL, OPEN = (load_library()[name] for name in ("epal1-1200", "epal1-800"))
WHITE = Material((0.8, 0.8, 0.8))
ROOM = Room((-9.0, -9.0), (9.0, 9.0), 6.0, WHITE, WHITE, WHITE)
LIGHT = Light(((0.0, 0.0, 1.0),), (1.0,), sharp=1)
POSE = LevelPose(2.0, 0.0, 0.0, 0.0)
CAMERA = RigidTransform.from_translation([0.0, 0.0, 1.5])
WIDE = Equirectangular(960, 480)


def hidden(*before: Solid, camera: CameraModel = WIDE, yaw_deg: float = 0.0) -> float | None:
    """Share of a pallet 2 m ahead that is hidden, at the given heading of the camera."""
    world_from_camera = CAMERA * RigidTransform.from_rotation(Rotation.from_euler("z", yaw_deg, degrees=True))
    solids = (*before, PalletBody(POSE, EPAL, WHITE))
    picture = render(lit(Scene(ROOM, LIGHT, solids)), camera_rays(camera), world_from_camera, smooth=False)
    camera_from_pallet = world_from_camera.inv() * POSE.transform()
    return hidden_share(camera, picture.solids, len(before), camera_from_pallet, EPAL)


@pytest.mark.parametrize("model", [EPAL, OPEN], ids=lambda model: model.name)
def test_points_lie_on_the_solid_parts_of_the_face(model: PalletModel) -> None:
    x, y, z = face_points(model).T
    assert (x == 0.0).all()
    assert np.abs(y).max() < model.width / 2
    assert 0.0 < z.min() < z.max() < model.height
    for opening in model.openings:
        across = (-y > opening.left) & (-y < opening.right)
        assert not (across & (z > opening.bottom) & (z < opening.top)).any()
        assert (across & (z > opening.top)).any()


def test_a_face_with_nothing_before_it_is_not_hidden() -> None:
    assert hidden() == 0.0


@pytest.mark.parametrize("side", [-1, 1])
def test_what_stands_before_one_half_hides_that_half(side: int) -> None:
    screen = Box(LevelPose(1.8, side * 0.45, 0.5, 0.0), (0.02, 0.9, 1.0), WHITE)
    assert hidden(screen) == pytest.approx(0.5, abs=0.06)


def test_what_stands_before_all_of_it_hides_it() -> None:
    assert hidden(Box(LevelPose(1.7, 0.0, 0.5, 0.0), (0.02, 3.0, 1.0), WHITE)) == 1.0


def test_what_stands_behind_hides_nothing() -> None:
    assert hidden(Box(LevelPose(3.5, 0.0, 0.5, 0.0), (0.1, 3.0, 1.0), WHITE)) == 0.0


def test_a_face_across_the_seam_is_whole() -> None:
    assert hidden(yaw_deg=180.0) == 0.0


@pytest.mark.parametrize("kind", [CameraKind.PINHOLE, CameraKind.KANNALA_BRANDT])
def test_a_face_that_the_image_cuts_has_no_share(kind: CameraKind) -> None:
    camera = camera_of(kind, 320)
    assert hidden(camera=camera, yaw_deg=150.0) is None
    if kind is CameraKind.KANNALA_BRANDT:
        assert hidden(camera=camera) == 0.0
