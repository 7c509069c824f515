"""A beam drawn by casting rays: each shot alone tells where its front edge is."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.drive import compose
from calibration.shelf.beam_line import BeamSearch, beam_lines
from calibration.shelf.plane import Foot
from palletloc.cameras import Equirectangular
from palletloc.geometry import FloatArray
from palletloc.io.recording import Recording
from palletloc.shelf import ShelfPlane

LEVEL, HEIGHT, FRONT = 1.2, 0.12, 1.9
TURN = float(np.radians(0.6))
CAMERA = Equirectangular(1920, 960)
MOUNTING = RigidTransform.from_components(
    [0.2, 0.05, 1.85], Rotation.from_euler("ZYX", [1.5, -1.0, 0.8], degrees=True)
)
POSES = np.stack([np.linspace(0, 1.5, 4), np.zeros(4), 0.01 * np.arange(4)], axis=1)
NOBODY = np.zeros((0, 3))


def drawn(pose: FloatArray) -> FloatArray:
    """Return a shot of an orange beam, lighter than the wall behind it, with its top surface darker."""
    u, v = np.meshgrid(np.arange(1920.0), np.arange(960.0))
    rays = MOUNTING.rotation.apply(CAMERA.unproject(np.stack([u, v], -1)).directions.reshape(-1, 3))
    yaw = pose[2]
    x, y = np.cos(yaw) * rays[:, 0] - np.sin(yaw) * rays[:, 1], np.sin(yaw) * rays[:, 0] + np.cos(yaw) * rays[:, 1]
    center = compose(pose, np.array([*MOUNTING.translation[:2], 0.0]))
    into = np.array([-np.sin(TURN), np.cos(TURN)])
    ahead = x * into[0] + y * into[1]
    distance = (FRONT - center[:2] @ into) / np.where(ahead > 1e-6, ahead, np.inf)
    height = np.where(ahead > 1e-6, MOUNTING.translation[2] + rays[:, 2] * distance, np.inf)
    edge = 0.004  # as wide as a pixel is there
    front = np.clip((LEVEL - height) / edge, -1, 1) + np.clip((height - LEVEL + HEIGHT) / edge, -1, 1)
    return np.asarray((90 + 45 * front).reshape(960, 1920))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory, recorded: Callable[..., Recording]) -> Recording:
    shelf = ShelfPlane(0.0, FRONT, -np.pi / 2, (0.0, LEVEL))
    pictures = (drawn(pose) for pose in POSES)
    return recorded(tmp_path_factory.mktemp("beam"), CAMERA, MOUNTING, POSES, shelf, pictures)


FOOT = Foot(np.array([0.9, 0.0]), np.pi / 2)
TRUE = FOOT.described(ShelfPlane(-FRONT * float(np.sin(TURN)), FRONT * float(np.cos(TURN)), TURN - np.pi / 2))


@pytest.mark.parametrize(("turn_deg", "off"), [(0.0, 0.0), (1.2, 0.03), (-0.3, -0.04)])
def test_the_front_edge_is_found_around_planes_that_are_off(
    recording: Recording, turn_deg: float, off: float
) -> None:
    search = BeamSearch(FOOT, float(np.radians(turn_deg)), TRUE[1] + off, 0.1, NOBODY)
    found = beam_lines(recording, range(4), POSES, search)
    assert len(found) == 1
    assert found[0].distance == pytest.approx(TRUE[1], abs=0.006)
    assert np.degrees(found[0].turn - TRUE[0]) == pytest.approx(0.0, abs=0.15)


def test_a_beam_near_the_camera_s_height_says_nothing(recording: Recording) -> None:
    near = replace(recording, shelf=replace(recording.shelf, levels=(1.8,)))
    assert beam_lines(near, range(4), POSES, BeamSearch(FOOT, 0.0, TRUE[1], 0.1, NOBODY)) == []


def test_a_wrong_height_moves_the_edge_as_its_sigma_says(recording: Recording) -> None:
    wrong = replace(recording, shelf=replace(recording.shelf, levels=(LEVEL + 0.01,)))
    (found,) = beam_lines(wrong, range(4), POSES, BeamSearch(FOOT, 0.0, TRUE[1], 0.1, NOBODY))
    assert 0.01 < abs(found.distance - TRUE[1]) < 2.5 * found.sigma[1]


def test_where_pallets_stand_nothing_is_looked_for(recording: Recording) -> None:
    everywhere = np.array([[-9.0, 9.0, LEVEL]])
    assert beam_lines(recording, range(4), POSES, BeamSearch(FOOT, 0.0, TRUE[1], 0.1, everywhere)) == []
