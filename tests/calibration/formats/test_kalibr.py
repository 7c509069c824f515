"""Kalibr's camchains."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.formats.any_format import read_cameras
from calibration.formats.camera_file import optical
from calibration.formats.kalibr import kalibr_text
from palletloc.cameras import KannalaBrandt
from palletloc.errors import PalletLocError
from tests.calibration.formats.texts import chain


@pytest.mark.parametrize("first_line", ["", "%YAML:1.0\n", "%YAML:1.0 # for OpenVINS\n---\n"])
def test_cameras_stand_in_the_order_of_their_numbers(tmp_path: Path, first_line: str) -> None:
    cameras = chain(13)
    content = yaml.safe_load(kalibr_text(cameras))
    path = tmp_path / "chain"
    path.write_text(first_line + yaml.safe_dump(dict(sorted(content.items(), reverse=True)), sort_keys=False))
    for expected, found in zip(cameras, read_cameras(path), strict=True):
        assert found.name == expected.name
        assert isinstance(found.camera, KannalaBrandt)
        assert isinstance(expected.camera, KannalaBrandt)
        assert found.camera.fx == expected.camera.fx
        np.testing.assert_allclose(
            found.first_from_camera.as_matrix(), expected.first_from_camera.as_matrix(), atol=1e-9
        )


def test_a_gap_leaves_a_place_open(tmp_path: Path) -> None:
    content = yaml.safe_load(kalibr_text(chain(4)))
    path = tmp_path / "chain.yaml"
    path.write_text(yaml.safe_dump({key: content[key] for key in ("cam0", "cam1", "cam3")}))
    with pytest.raises(PalletLocError, match="cam2: is missing, on which the place of cam3 rests"):
        read_cameras(path)
    path.write_text(yaml.safe_dump({"cam3": content["cam3"]}))
    assert [camera.name for camera in read_cameras(path)] == ["cam3"]


@pytest.mark.parametrize("key", ["T_cam_imu", "T_imu_cam"])
def test_places_may_be_told_by_the_inertial_sensor(tmp_path: Path, key: str) -> None:
    cameras = chain(3)
    content = yaml.safe_load(kalibr_text(cameras))
    imu_from_first = RigidTransform.from_components([0.3, -0.1, 0.2], Rotation.from_rotvec([1.0, 0.2, -0.3]))
    for camera in cameras:
        matrix = imu_from_first.as_matrix() @ optical(camera.first_from_camera)
        content[camera.name].pop("T_cn_cnm1", None)
        content[camera.name][key] = (np.linalg.inv(matrix) if key == "T_cam_imu" else matrix).tolist()
    path = tmp_path / "chain.yaml"
    path.write_text(yaml.safe_dump(content))
    for expected, found in zip(cameras, read_cameras(path), strict=True):
        np.testing.assert_allclose(
            found.first_from_camera.as_matrix(), expected.first_from_camera.as_matrix(), atol=1e-9
        )
