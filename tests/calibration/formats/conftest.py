"""Reading the camera of a text."""

import json
from pathlib import Path

import pytest

from calibration.formats.any_format import read_cameras
from palletloc.cameras import CameraModel
from tests.calibration.formats.texts import Written


@pytest.fixture
def read(tmp_path: Path) -> Written:
    """Return what reads the camera of a text, by a name that says nothing of its format."""

    def from_text(text: object, name: str = "camera.file", number: int = 0) -> CameraModel:
        path = tmp_path / name
        path.write_text(text if isinstance(text, str) else json.dumps(text))
        return read_cameras(path)[number].camera

    return from_text
