from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.shelf.plane import Foot
from calibration.shelf.upright_tags import TagsOnUprights, tag_places, tag_plane
from calibration.targets.targets import SingleTag, TargetError
from palletloc.cameras import Equirectangular
from palletloc.geometry import Image, LevelPose
from palletloc.io.recording import Recording
from palletloc.shelf import ShelfPlane
from tests.calibration.expecting import present

FRONT, TURN = 1.8, float(np.radians(1.0))
TAGS = TagsOnUprights("DICT_4X4_50", 0.3, 0.01)
PLACES = {3: (-0.8, 1.3), 7: (1.0, 1.6)}
"""Middles along the shelf and heights."""
POSES = np.array([[0.0, 0.0, 0.0], [0.4, 0.02, 0.03]])
CAMERA = Equirectangular(1600, 800)
FOOT = Foot(np.array([0.2, 0.0]), np.pi / 2)


def hung(place: float, height: float) -> RigidTransform:
    """Return ``odom_from_board`` of a tag before the front; its origin is the upper left corner, y is down."""
    shelf = Rotation.from_euler("z", TURN)
    rotation = shelf * Rotation.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    corner = shelf.apply([place - TAGS.size / 2, FRONT - TAGS.offset, 0.0]) + np.array([0, 0, height + TAGS.size / 2])
    return RigidTransform.from_components(corner, rotation)


@pytest.fixture(scope="module")
def recording(
    tmp_path_factory: pytest.TempPathFactory, render: Callable[..., Image], recorded: Callable[..., Recording],
    forklift_from_camera: RigidTransform,
) -> Recording:  # fmt: skip
    def drawn(x: float, y: float, yaw: float) -> Image:
        camera_from_odom = (LevelPose(x, y, 0.0, yaw).transform() * forklift_from_camera).inv()
        tags = [
            (SingleTag(TAGS.size, TAGS.dictionary, number), camera_from_odom * hung(*place))
            for number, place in PLACES.items()
        ]
        return render(CAMERA, tags)

    shelf, pictures = ShelfPlane(0.0, FRONT, -np.pi / 2), (drawn(*pose) for pose in POSES.tolist())
    return recorded(tmp_path_factory.mktemp("tags"), CAMERA, forklift_from_camera, POSES, shelf, pictures)


def test_tags_on_two_uprights_give_the_front_behind_them(recording: Recording) -> None:
    places = tag_places(recording, range(2), POSES, TAGS)
    assert places.keys() == PLACES.keys()
    found = tag_plane(places, FOOT, TAGS, FRONT + 0.3)
    front = ShelfPlane(-FRONT * float(np.sin(TURN)), FRONT * float(np.cos(TURN)), TURN - np.pi / 2)
    turn, distance = FOOT.described(front)
    assert found is not None
    assert found.distance == pytest.approx(distance, abs=0.004)
    assert np.degrees(found.turn - turn) == pytest.approx(0.0, abs=0.2)


def test_an_unknown_dictionary_is_refused(recording: Recording) -> None:
    with pytest.raises(TargetError):
        tag_places(recording, range(1), POSES, TagsOnUprights("DICT_9X9", 0.2))


def test_tags_elsewhere_do_not_count() -> None:
    far = {1: np.array([[0.0, 4.0]]), 2: np.array([[1.0, 4.0]])}
    assert tag_plane(far, FOOT, TAGS, 1.8) is None
    assert tag_plane({}, FOOT, TAGS) is None


def test_one_tag_tells_the_distance_but_hardly_the_heading() -> None:
    found = present(tag_plane({1: np.array([[0.2, 1.8]])}, FOOT, TAGS))
    assert found.distance == pytest.approx(1.81, abs=1e-6)
    assert np.degrees(found.sigma[0]) > 3
