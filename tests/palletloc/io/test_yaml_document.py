import math
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.cameras.double_sphere import DoubleSphere
from palletloc.cameras.dual_fisheye import DualFisheye, FisheyeLens
from palletloc.cameras.equirectangular import Equirectangular
from palletloc.cameras.eucm import Eucm
from palletloc.cameras.kannala_brandt import KannalaBrandt
from palletloc.cameras.mei import Mei
from palletloc.cameras.pinhole import Pinhole, RationalPinhole
from palletloc.cameras.protocol import CameraModel
from palletloc.cameras.stitched_equirectangular import StitchedEquirectangular, StitchedLens
from palletloc.io.camera_spec import (
    angles_from_transform,
    camera_from_spec,
    degrees,
    read_camera,
    spec_from_camera,
    transform_from_angles,
)
from palletloc.io.reading import InputError
from palletloc.io.schema import KannalaBrandtSpec, MountingSpec, PinholeSpec, RecordingSpec, ShelfSpec
from palletloc.io.yaml_document import DocumentError, read_document, write_document

TEXT = """\
format: 1
camera: {model: equirectangular, width: 3840, height: 1920}
forklift_from_camera: {translation_m: [0.30, -0.08, 1.85], roll_pitch_yaw_deg: [-0.7, 0.9, -1.2]}
shelf:
  point_m: [3.84, 1.78]
  facing_deg: -91.6
  levels_m: [0.0, 1.55]
pallets: [t11-plastic]
"""
CAMERA = "{model: equirectangular, width: 3840, height: 1920}"
FISHEYE = (
    "{model: kannala_brandt, width: 900, height: 900, focal_px: [280, 281], center_px: [449.5, 449.5],"
    " distortion: [0.01, 0, 0, 0], max_angle_deg: 95}"
)
LENS = (
    "{focal_px: [280, 280], center_px: [449.5, 449.5], distortion: [0, 0, 0, 0], max_angle_deg: 95,"
    " translation_m: [0.02, 0, 0], roll_pitch_yaw_deg: [0, 0, 0]}"
)
DUAL = f"{{model: dual_fisheye, width: 1800, height: 900, lenses: [{LENS}, {LENS}]}}"


def read(folder: Path, text: str) -> RecordingSpec:
    path = folder / "recording.yaml"
    path.write_text(text)
    return read_document(path, RecordingSpec)


def test_the_form_of_the_documentation_is_read(tmp_path: Path) -> None:
    spec = read(tmp_path, "\ufeff" + TEXT.replace("\n", "\r\n"))
    assert spec.camera.width == 3840
    assert spec.forklift_from_camera.translation_m == (0.3, -0.08, 1.85)
    assert spec.forklift_from_camera.rotation_sigma_deg is None
    assert spec.shelf.levels_m == (0.0, 1.55)
    assert spec.pallets == ("t11-plastic",)


def test_other_cameras_and_a_number_that_yaml_takes_for_a_text_are_read(tmp_path: Path) -> None:
    assert read(tmp_path, TEXT.replace("-91.6", "1e-3")).shelf.facing_deg == 1e-3
    for camera in (FISHEYE, DUAL):
        assert read(tmp_path, TEXT.replace(CAMERA, camera)).camera.height == 900


BAD = [
    ("facing_deg", "facing_dg", r": shelf: unknown key 'facing_dg'; did you mean 'facing_deg'\?"),
    ("width", "widht", r": camera: unknown key 'widht'; did you mean 'width'\?"),
    ("shelf:", "shelff:", r": unknown key 'shelff'; did you mean 'shelf'\?"),
    ("width: 3840, ", "", r": camera\.width: is missing"),
    ("format: 1\n", "", r": format: is missing"),
    ("format: 1", "format: 2", r": format: .*, got 2"),
    ("model: equirectangular", "model: equirect", r": camera: unknown model 'equirect'; did you mean 'equir"),
    ("model: equirectangular, ", "", r": camera: expected a mapping with the key model"),
    (CAMERA, "none", r": camera: expected a mapping, got 'none'"),
    ("width: 3840", "width: 0", r": camera\.width: .*, got 0"),
    ("width: 3840", "width: 3840.5", r": camera\.width: .*, got 3840\.5"),
    ("width: 3840", "width: 30000", r": camera\.width: .*, got 30000"),
    ("[3.84, 1.78]", "[3.84]", r": shelf\.point_m: expected 2 finite numbers, got \[3\.84\]"),
    ("[3.84, 1.78]", "3.84", r": shelf\.point_m: expected 2 finite numbers, got 3\.84"),
    ("1.78", ".nan", r": shelf\.point_m: expected 2 finite numbers, got \[3\.84, nan\]"),
    ("-91.6", ".inf", r": shelf\.facing_deg: expected a finite number, got inf"),
    ("-91.6", "west", r": shelf\.facing_deg: expected a finite number, got 'west'"),
    ("-91.6", "yes", r": shelf\.facing_deg: expected a finite number, got True"),
    ("1.55]", ".nan]", r": shelf\.levels_m\[1\]: expected a finite number, got nan"),
    ("1.85]", "1.85, 2]", r": forklift_from_camera\.translation_m: expected 3 finite numbers"),
    (
        "-1.2]",
        "-1.2], translation_sigma_m: [0.01, -1, 0]",
        r": forklift_from_camera\.translation_sigma_m: expected 3 finite non-negative numbers",
    ),
    ("[t11-plastic]", "[]", r": pallets: expected at least 1 in the list"),
    ("[t11-plastic]", "t11-plastic", r": pallets: expected a list, got 't11-plastic'"),
    ("[t11-plastic]", "[1200]", r": pallets\[0\]: .*, got 1200"),
    (CAMERA, FISHEYE.replace("280,", "-280,"), r": camera\.focal_px: expected 2 finite positive numbers"),
    (CAMERA, FISHEYE.replace("[0.01, 0, 0, 0]", "[0, 0]"), r": camera\.distortion: expected 4 finite numbers"),
    (CAMERA, FISHEYE.replace(": 95", ": 190"), r": camera\.max_angle_deg: .*, got 190"),
    (CAMERA, DUAL.replace("center_px", "centre_px"), r": camera\.lenses\[0\]: unknown key 'centre_px'; did you"),
    (CAMERA, DUAL.replace(f", {LENS}", ""), r": camera\.lenses: expected at least 2 in the list"),
    ("format: 1", "format: 1\nformat: 1", r", line 2: is not yaml: key 'format' stands there twice"),
    ("[3.84, 1.78]", "[3.84, 1.78", r", line \d+: is not yaml: "),
    ("format: 1", "\tformat: 1", r", line 1: is not yaml: "),
    ("format: 1", "format: 2024-13-45", r": is not yaml: "),
    (TEXT, "", r": expected the keys format, camera, .*, got None"),
    (TEXT, "- 1", r": expected the keys format, camera"),
    (TEXT, "[" * 1500, r": is not yaml"),
    ("-91.6", "268:26:35", r": shelf\.facing_deg: .* got '268:26:35'; is it degrees:minutes:seconds\?.* 268\.443056"),
    ("1.55]", "010]", r": shelf\.levels_m\[1\]: .* got '010'; expected it in decimals, without zeros before it"),
    ("1.55]", "0x1F]", r": shelf\.levels_m\[1\]: .* got '0x1F'; expected it in decimals"),
    ("1.55]", "0b11]", r": shelf\.levels_m\[1\]: .* got '0b11'; expected it in decimals"),
    ("-91.6", "-451.6", r": shelf\.facing_deg: expected degrees from -360 to 360, a whole turn; got -451\.6"),
    (
        "1.55]",
        "1550]",
        r": shelf\.levels_m\[1\]: .* metres from -10 to 50.*; got 1550; are these millimetres\?",
    ),
    ("1.55]", "1e308]", r": shelf\.levels_m\[1\]: expected metres from -10 to 50.*; got 1e\+308"),
    ("1.55]", "1e5]", r": shelf\.levels_m\[1\]: expected metres from -10 to 50.*; got 100000"),
    ("1.85]", "-1.7e308]", r": forklift_from_camera\.translation_m\[2\]: expected metres from -100 to 100"),
    (
        "-1.2]",
        "-1.2], rotation_sigma_deg: [0, 0, 1e308]",
        r": .*rotation_sigma_deg\[2\]: expected degrees from 0 to 90",
    ),
    ("1.55]", "9" * 20000 + "]", r": shelf\.levels_m\[1\]: expected a finite number, got '9+ \.\.\."),
    ("1.55]", "0x" + "F" * 20000 + "]", r": shelf\.levels_m\[1\]: expected a finite number, got '0xF+ \.\.\."),
    ("width: 3840", "width: 07400", r": camera\.width: .*, got '07400'"),
    ("1.55]", "!!python/name:os.system ]", r", line 7: is not yaml: the tag .* is not understood"),
    ("levels_m: [0.0, 1.55]", "levels_m: &a [*a]", r", line 7: is not yaml: '\*a' stands for itself"),
]


@pytest.mark.parametrize(("old", "new", "said"), BAD)
def test_a_bad_document_is_an_error_with_file_and_key(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in TEXT
    with pytest.raises(DocumentError, match=rf"recording\.yaml{said}") as caught:
        read(tmp_path, TEXT.replace(old, new))
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match=r"none\.yaml: no such file"):
        read_document(tmp_path / "none.yaml", RecordingSpec)


def test_references_are_read_but_no_bomb_of_them(tmp_path: Path) -> None:
    level = TEXT.replace("[0.0, 1.55]", "[&a 0.0, *a]")
    assert read(tmp_path, level).shelf.levels_m == (0.0, 0.0)
    rows = "\n".join(f"    - &b{n} [{', '.join([f'*b{n - 1}'] * 9)}]" for n in range(1, 12))
    bomb = TEXT.replace("[0.0, 1.55]", "\n    - &b0 [1, 1]\n" + rows)
    with pytest.raises(DocumentError, match=r"recording\.yaml, line \d+: is not yaml: its references stand for more"):
        read(tmp_path, bomb)


def test_a_document_of_very_many_values_is_refused_before_it_fills_the_memory(tmp_path: Path) -> None:
    with pytest.raises(DocumentError, match=r"is not yaml: has more than 500000 values"):
        read(tmp_path, TEXT.replace("[0.0, 1.55]", f"[{'1,' * 600_000}]"))


numbers = st.floats(-1e6, 1e6)
names = st.text(st.characters(exclude_categories=("C", "Z")), min_size=1)


@settings(max_examples=30)
@given(
    st.builds(
        RecordingSpec,
        format=st.just(1),
        camera=st.builds(
            PinholeSpec,
            model=st.just("pinhole"),
            width=st.integers(1, 16_384),
            height=st.integers(1, 16_384),
            focal_px=st.tuples(*[st.floats(1e-3, 1e6)] * 2),
            center_px=st.tuples(numbers, numbers),
            distortion=st.tuples(*[numbers] * 5),
        ),
        forklift_from_camera=st.builds(
            MountingSpec,
            translation_m=st.tuples(*[st.floats(-100, 100)] * 3),
            roll_pitch_yaw_deg=st.tuples(*[st.floats(-360, 360)] * 3),
            rotation_sigma_deg=st.none() | st.tuples(*[st.floats(0, 10)] * 3),
        ),
        shelf=st.builds(
            ShelfSpec,
            point_m=st.tuples(numbers, numbers),
            facing_deg=st.floats(-360, 360),
            levels_m=st.none() | st.lists(st.floats(-10, 50), min_size=1, max_size=3).map(tuple),
        ),
        pallets=st.lists(names, min_size=1, max_size=3).map(tuple),
    )
)
def test_a_document_written_is_the_document_read(spec: RecordingSpec) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "recording.yaml"
        write_document(path, spec)
        assert read_document(path, RecordingSpec) == spec


def test_exponents_survive_yamls_idea_of_a_number(tmp_path: Path) -> None:
    spec = read(tmp_path, TEXT).model_copy(update={"shelf": ShelfSpec(point_m=(1e-7, -1e-16), facing_deg=math.pi)})
    write_document(tmp_path / "again.yaml", spec)
    assert read_document(tmp_path / "again.yaml", RecordingSpec) == spec


def fisheye(cx: float) -> KannalaBrandt:
    return KannalaBrandt(1800, 900, 280.0, 281.0, cx, 449.5, 0.01, -0.002, 3e-4, -1e-5, np.radians(97.5))


CAMERAS: list[CameraModel] = [
    Equirectangular(3840, 1920),
    Pinhole(640, 480, 500.0, 501.0, 320.5, 241.0, -0.1, 0.02, 1e-3, -2e-3, 3e-4),
    RationalPinhole(640, 480, 500.0, 501.0, 320.5, 241.0, 0.35, -0.12, 1e-3, -2e-3, 0.03, 0.61, -0.05, 0.02),
    fisheye(449.5),
    Mei(1280, 960, 409.0, 410.5, 630.3, 431.9, 1.053, -0.0083, 0.0118, 0.0228, -0.0042, np.radians(105.0)),
    DoubleSphere(752, 480, 210.0, 211.0, 365.8, 249.4, -0.24, 0.566, np.radians(110.0)),
    Eucm(752, 480, 210.0, 211.0, 365.8, 248.9, 0.586, 1.139, np.radians(105.0)),
    DualFisheye(
        FisheyeLens(fisheye(449.5), transform_from_angles((0.02, 0.0, 0.001), (0.5, -0.25, 0.75))),
        FisheyeLens(fisheye(1349.5), transform_from_angles((-0.02, 0.0, 0.0), (1.0, 0.5, 179.5))),
    ),
    StitchedEquirectangular(
        1920,
        960,
        StitchedLens(transform_from_angles((0.02, 0.0, 0.001), (0.5, -0.25, 0.75)), 0.01, -0.002),
        StitchedLens(transform_from_angles((-0.02, 0.0, 0.0), (1.0, 0.5, 179.5))),
    ),
]


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: type(camera).__name__)
def test_a_camera_and_its_description_survive_the_way_to_a_file_and_back(camera: CameraModel) -> None:
    spec = spec_from_camera(camera)
    again = camera_from_spec(spec)
    assert spec_from_camera(again) == spec
    assert type(again) is type(camera)
    assert (again.width, again.height) == (camera.width, camera.height)
    points = np.random.default_rng(0).normal(size=(200, 3))
    there, back = camera.project(points), again.project(points)
    assert there.valid.sum() > 5
    np.testing.assert_array_equal(there.valid, back.valid)
    assert_allclose(back.pixels, there.pixels, atol=1e-6)


def test_the_numbers_of_a_pinhole_stand_where_opencv_has_them() -> None:
    size = {"width": 640, "height": 480}
    numbers = {"focal_px": (1.0, 2.0), "center_px": (3.0, 4.0), "distortion": (0.1, 0.2, 0.3, 0.4, 0.5)}
    spec = PinholeSpec.model_validate({"model": "pinhole", **size, **numbers})
    camera = camera_from_spec(spec)
    assert isinstance(camera, Pinhole)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (1.0, 2.0, 3.0, 4.0)
    assert (camera.k1, camera.k2, camera.p1, camera.p2, camera.k3) == (0.1, 0.2, 0.3, 0.4, 0.5)


def test_numbers_that_describe_no_camera_are_refused() -> None:
    spec = spec_from_camera(fisheye(449.5))
    assert isinstance(spec, KannalaBrandtSpec)
    with pytest.raises(ValueError, match="max_angle"):
        camera_from_spec(spec.model_copy(update={"distortion": (-1.0, 0.0, 0.0, 0.0)}))


def test_a_camera_that_files_do_not_know_is_refused() -> None:
    class Other(Equirectangular):
        pass

    assert spec_from_camera(Other(4, 2)).model == "equirectangular"
    with pytest.raises(ValueError, match="of the kind SimpleNamespace has no form in files"):
        spec_from_camera(cast("CameraModel", SimpleNamespace(width=4, height=2)))


def test_the_rotation_is_yaw_after_pitch_after_roll() -> None:
    roll, pitch, yaw = np.radians([10.0, 20.0, 30.0])
    about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    transform = transform_from_angles((1.0, 2.0, 3.0), (10.0, 20.0, 30.0))
    assert_allclose(transform.as_matrix()[:3, :3], about_z @ about_y @ about_x, atol=1e-12)
    assert_allclose(transform.translation, [1.0, 2.0, 3.0])


angles = st.floats(-180, 180)


@given(st.tuples(angles, angles, angles), st.tuples(*[st.floats(-10, 10)] * 3))
@example((20.0, 90.0, 30.0), (0.0, 0.0, 0.0))
@example((20.0, -90.0, 30.0), (0.0, 0.0, 0.0))
def test_a_transform_survives_the_way_to_angles_and_back(
    roll_pitch_yaw: tuple[float, float, float], translation: tuple[float, float, float]
) -> None:
    rotation = Rotation.from_euler("xyz", roll_pitch_yaw, degrees=True)
    transform = RigidTransform.from_components(translation, rotation)
    again = transform_from_angles(*angles_from_transform(transform))
    assert_allclose(again.as_matrix(), transform.as_matrix(), atol=2e-7)


@given(st.integers(-180_000, 180_000))
def test_degrees_of_typed_angles_are_the_typed_ones(thousandths: int) -> None:
    assert degrees(float(np.radians(thousandths / 1000))) == thousandths / 1000


@pytest.mark.parametrize(
    "size", ["width: 3840, height: 1900", "width: 3840, height: 1700", "width: 1920, height: 1920"]
)
def test_images_that_cannot_be_whole_panoramas_are_refused(tmp_path: Path, size: str) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(f"camera: {{model: equirectangular, {size}}}\n")
    with pytest.raises(DocumentError, match=r"camera\.yaml: camera: an equirectangular image is 360 x 180 degrees"):
        read_camera(path)
    path.write_text("camera: {model: equirectangular, width: 3842, height: 1920}\n")
    assert read_camera(path).width == 3842
