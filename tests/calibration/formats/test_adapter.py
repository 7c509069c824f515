from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration.formats.convert import read_cameras
from calibration.formats.fields import FormatError
from palletloc.cameras import DoubleSphere, Eucm, Pinhole

SHARED = Path(__file__).resolve().parents[3].parent / "shared/data/real_lenses"
ADAPTER = {
    "double_sphere": (
        {"xi": -0.24, "alpha": 0.566},
        DoubleSphere(752, 480, 210.0, 211.0, 365.8, 249.4, -0.24, 0.566),
    ),
    "eucm": ({"alpha": 0.586, "beta": 1.139}, Eucm(752, 480, 210.0, 211.0, 365.8, 249.4, 0.586, 1.139)),
    "pinhole": (
        {"k1": -0.28, "k2": 0.09, "p1": 0.002, "p2": -0.0015, "k3": 0.0},
        Pinhole(752, 480, 210.0, 211.0, 365.8, 249.4, -0.28, 0.09, 0.002, -0.0015),
    ),
}


def adapter_file(path: Path, terms: dict[str, float]) -> Path:
    lens = {"fx": 210.0, "fy": 211.0, "cx": 365.8, "cy": 249.4}
    path.write_text(yaml.safe_dump({"image": {"width": 752, "height": 480}, "parameter": {**lens, **terms}}))
    return path


@pytest.mark.parametrize("model", sorted(ADAPTER))
def test_files_of_the_adapter_are_told_apart_by_their_numbers(model: str, tmp_path: Path) -> None:
    terms, expected = ADAPTER[model]
    found = read_cameras(adapter_file(tmp_path / "lens.yml", terms))[0].camera
    assert type(found) is type(expected)
    points = np.random.default_rng(0).normal(size=(500, 3))
    np.testing.assert_array_equal(found.project(points).pixels, expected.project(points).pixels)


def test_unknown_numbers_of_an_adapter_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="parameter: expected fx, fy, cx, cy and one of"):
        read_cameras(adapter_file(tmp_path / "lens.yml", {"xi": 1.0}))


@pytest.mark.skipif(not SHARED.is_dir(), reason="the lenses are not there")
def test_four_models_of_one_real_lens_see_the_same() -> None:
    cameras = [read_cameras(path)[0].camera for path in sorted((SHARED / "one_lens").glob("*.yml"))]
    assert len(cameras) == 4
    u, v = np.meshgrid(np.linspace(60, 690, 12), np.linspace(50, 430, 9))
    seen = [camera.unproject(np.stack([u.ravel(), v.ravel()], axis=1)) for camera in cameras]
    for other in seen[1:]:
        apart = np.degrees(np.linalg.norm(other.directions - seen[0].directions, axis=1))
        assert np.sqrt((apart**2).mean()) < 0.15
