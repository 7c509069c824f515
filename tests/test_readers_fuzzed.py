"""Every reader against damaged files: what it does not take it refuses with an error of the project.

A reader is a row of `READERS`: a small valid file, and the function that reads it. A new reader adds a row.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calibration.formats.any_format import read_cameras
from calibration.intrinsics.corner_file import read_corners
from calibration.intrinsics.task import read_intrinsics
from calibration.mounting.task import read_mounting_task
from calibration.plan.task import read_layout
from palletloc.errors import PalletLocError
from palletloc.geometry import LevelPose
from palletloc.io.camera_spec import read_camera
from palletloc.io.config_file import read_config
from palletloc.io.images import read_image
from palletloc.io.measurements import read_measurements, read_refusals
from palletloc.io.recording import ShotFile, check_shelf, read_recording
from palletloc.io.run_folder import JOURNAL, MEASUREMENTS, REFUSALS, STATUS, Run, RunFolder
from palletloc.io.starts import read_starts
from palletloc.io.tracks import read_tracks
from palletloc.io.truth import read_truth, read_tum
from palletloc.measurement import PalletMeasurement, YawSource
from palletloc.pallet_library import read_pallets
from palletloc.survey.plan import read_survey_plan
from palletloc.survey.reading import read_survey
from palletloc.trajectory import TrajectoryError
from tests.damage import damaged
from tracking import Odometry, PalletTracker
from tracking.config import read_tracker_config
from tracking.files import read_events

CAMERA = "camera: {model: equirectangular, width: 64, height: 32}\n"
LENS = (
    "camera: {model: kannala_brandt, width: 900, height: 900, focal_px: [280, 281], center_px: [449.5, 449.5],"
    " distortion: [0.01, 0, 0, 0], max_angle_deg: 95}\n"
)
RECORDING = {
    "recording.yaml": f"""\
format: 1
{CAMERA}forklift_from_camera: {{translation_m: [0.3, -0.1, 1.8], roll_pitch_yaw_deg: [0, 0.5, 0]}}
shelf: {{point_m: [3.0, 2.0], facing_deg: -90.0, levels_m: [0.0, 1.55]}}
pallets: [mine]
""",
    "pallets.yaml": """\
mine:
  width_m: 1.1
  height_m: 0.144
  depth_m: 1.1
  openings:
  - {center_m: -0.265, bottom_m: 0.024, width_m: 0.29, height_m: 0.092}
  - {center_m: 0.265, bottom_m: 0.024, width_m: 0.29, height_m: 0.092}
""",
    "shots.csv": "time_s,file\n0.0,images/0.png\n0.5,images/1.png\n",
    "odometry.csv": "time_s,x_m,y_m,yaw_rad,speed_mps,yaw_rate_radps\n0,0,0,0,0.4,0.1\n0.5,0.2,0,0.05,0.4,0.1\n",
}
POSE = "2.027123,-1.521000,0.000000,-0.250000"
SPREAD = "4e-6,1e-6,0.0,0.0,9e-6,0.0,0.0,1e-6,0.0,1e-6"
COVARIANCE = "cov_xx,cov_xy,cov_xz,cov_xw,cov_yy,cov_yz,cov_yw,cov_zz,cov_zw,cov_ww"
POSES = "x_m,y_m,z_m,yaw_rad"
SHOTS = (ShotFile(0.0, "images/0.png"), ShotFile(0.5, "images/1.png"))
RUN = Run("0123", "paper", "4567", "", "1.0")
ROW = ["0.5", "images/1.png", "t11", *POSE.split(","), *SPREAD.split(","), "0.5", "top"]
LANDXML = """\
<?xml version="1.0" encoding="UTF-8"?>
<LandXML xmlns="http://www.landxml.org/schema/LandXML-1.2" version="1.2">
  <Units><Metric areaUnit="squareMeter" linearUnit="meter" volumeUnit="cubicMeter"/></Units>
  <CgPoints><CgPoint name="A">190.6996 413.7033 11.6112</CgPoint><CgPoint name="B">1 2 3</CgPoint></CgPoints>
</LandXML>
"""
GSI = """\
110001+0000000A 21.022+12345678 22.022+09876543 31..00+00012345 81..00+00001234 82..00+00005678 83..00+00000910
110002+0000000B 21.022+02345678 22.022+09976543 31..00+00022345 81..00+00002234 82..00+00006678 83..00+00000920
"""
KALIBR = """\
cam0:
  camera_model: pinhole
  distortion_coeffs: [0.01, 0.002, 0.0, 0.0]
  distortion_model: equidistant
  intrinsics: [280.0, 281.0, 320.5, 240.5]
  resolution: [640, 480]
cam1:
  T_cn_cnm1: [[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
  camera_model: pinhole
  distortion_coeffs: [0.01, 0.002, 0.0, 0.0]
  distortion_model: equidistant
  intrinsics: [280.0, 281.0, 320.5, 240.5]
  resolution: [640, 480]
"""
ROS = """\
image_width: 640
image_height: 480
camera_name: front
camera_matrix: {rows: 3, cols: 3, data: [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.2, 0.05, 0.001, -0.002, 0.0]}
"""
METASHAPE = """\
<?xml version="1.0" encoding="UTF-8"?>
<calibration><projection>frame</projection><width>1600</width><height>1200</height><f>1000</f><cx>3</cx><k1>0.01</k1>
</calibration>
"""
OPENCV = """\
%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500., 0., 320., 0., 510., 240., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.2, 0.05, 0.001, -0.002, 0. ]
"""
CAMODOCAL = """\
%YAML:1.0
---
model_type: MEI
camera_name: camera
image_width: 800
image_height: 600
mirror_parameters: {xi: 1.7}
distortion_parameters: {k1: -0.02, k2: 0.9, p1: 0.001, p2: -0.002}
projection_parameters: {gamma1: 700., gamma2: 702., u0: 405., v0: 296.}
"""
SURVEY = """\
file: survey.csv
sigma_m: 0.0006
stops: [{name: S1, time_s: 1.05}, {name: S2, time_s: 3.16}]
bodies:
  forklift: {V1: [-0.9, 0.45, 2.10], V2: [-0.9, -0.45, 2.08], V3: [0.55, -0.40, 1.20]}
  A: {A-LL: [0, 0.55, 0.012], A-LR: [0, -0.55, 0.012], A-UL: [0, 0.55, 0.132]}
"""
BOARD = "charuco: {columns: 7, rows: 5, square_m: 0.1, marker_m: 0.075, dictionary: DICT_4X4_250, first_id: 0}"
EXTRINSICS = f"""\
format: 1
{CAMERA}shots: [images/0.png]
targets:
  B1:
    {BOARD}
    corners_m: {{top_left: [2, 1, 1], top_right: [2, 0.3, 1], bottom_left: [2, 1, 0.5]}}
    sigma_m: 0.0005
"""
INTRINSICS = "format: 1\nwidth: 640\nheight: 480\nlenses: 1\ncorners: corners.csv\n"
LAYOUT = f"""\
format: 1
{CAMERA}forklift_from_camera: {{translation_m: [0.3, -0.1, 1.8], roll_pitch_yaw_deg: [0, 0.5, 0]}}
targets:
  B1:
    {BOARD}
    sigma_m: 0.001
    center_m: [2, 1, 1]
    facing_deg: 180
"""
CORNERS = "shot,board,lens,x_m,y_m,z_m,u_px,v_px\n" + "".join(
    f"a,B,0,{x / 10},{y / 10},0,{100 + 50 * x},{100 + 50 * y}\n" for x in range(3) for y in range(3)
)


def picture(suffix: str) -> bytes:
    image = np.random.default_rng(0).integers(0, 255, (16, 32, 3), dtype=np.uint8)
    return cv2.imencode(suffix, image)[1].tobytes()


def snapshot() -> bytes:
    tracker, pose = PalletTracker(), LevelPose(2.0, 1.8, 0.0, 1.57)
    for k in range(12):
        tracker.push(Odometry(k / 10, LevelPose(0.05 * k, 0.0, 0.0, 0.0)))
        tracker.push(PalletMeasurement(k / 10, "any", pose, 1e-4 * np.eye(4), 0.9, YawSource.FACE))
    return json.dumps(tracker.snapshot()).encode()


def restore(path: Path) -> None:
    try:
        plain = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        return
    PalletTracker.restore(plain)


def resume(path: Path) -> None:
    with RunFolder(path.parent, RUN, Path("approach"), SHOTS, resume=True) as output:
        assert output.done <= len(SHOTS)


def take_up(path: Path) -> None:
    with RunFolder(path.parent, RUN, Path("approach"), SHOTS, resume=True) as output:
        assert all(0 <= number < len(SHOTS) for number, _ in output.remaining())


def recording(path: Path) -> None:
    found = read_recording(path.parent)
    try:
        check_shelf(found)
    except TrajectoryError:
        return


class Reader(NamedTuple):
    read: Callable[[Path], object]
    """Takes the path of the damaged file."""
    name: str
    """Of the file."""
    content: str | bytes
    """A valid one."""
    beside: Mapping[str, str] = MappingProxyType({})
    """What else is in its folder."""


READERS = {
    **{name: Reader(recording, name, text, RECORDING) for name, text in RECORDING.items()},
    "pallets alone": Reader(read_pallets, "pallets.yaml", RECORDING["pallets.yaml"]),
    "measurements": Reader(
        read_measurements, "m.csv", f"time_s,file,model,{POSES},{COVARIANCE},score,yaw_from\n{','.join(ROW)}\n"
    ),
    "refusals": Reader(read_refusals, "r.csv", "time_s,file,model,stage,reason\n0.5,images/1.png,t11,yaw,no_line\n"),
    "starts": Reader(lambda path: read_starts(path, SHOTS), "i.csv", f"time_s,model,{POSES}\n0.5,t11,{POSE}\n"),
    "tracks": Reader(
        read_tracks,
        "tracks.csv",
        f"time_s,track,model,state,{POSES},{COVARIANCE},age_s,hits\n0.5,1,t11,confirmed,{POSE},{SPREAD},0.1,3\n",
    ),
    "events": Reader(
        read_events,
        "events.csv",
        "time_s,event,track,distance,limit,age_s,window_s,revised,reason\n0.5,born,1,,,,,no,\n0.6,gated,1,30.0,20.0,,,yes,far\n",
    ),
    "true path": Reader(
        lambda path: read_truth(path.parent.parent),
        "truth/forklift.csv",
        f"time_s,{POSES}\n0.0,{POSE}\n0.5,{POSE}\n",
        {"truth/pallets.csv": f"id,model,{POSES}\nA,t11,{POSE}\n"},
    ),
    "true pallets": Reader(
        lambda path: read_truth(path.parent.parent),
        "truth/pallets.csv",
        f"id,model,{POSES}\nA,t11,{POSE}\nB,t11,{POSE}\n",
        {"truth/forklift.csv": f"time_s,{POSES}\n0.0,{POSE}\n0.5,{POSE}\n"},
    ),
    "tum": Reader(read_tum, "path.tum", "0.0 1 2 0 0 0 0 1\n0.5 1 2 0 0 0 0.1 0.995\n"),
    "survey csv": Reader(read_survey, "survey.csv", "name,x_m,y_m,z_m\nA,1,2,3\nB,4,5,6.5\n"),
    "survey gsi": Reader(read_survey, "survey.gsi", GSI),
    "survey landxml": Reader(read_survey, "survey.xml", LANDXML),
    "survey plan": Reader(read_survey_plan, "survey.yaml", SURVEY),
    "rig": Reader(read_camera, "rig.yaml", LENS),
    "camera, own": Reader(read_cameras, "camera.yaml", "format: 1\n" + LENS),
    "camera, kalibr": Reader(read_cameras, "camchain.yaml", KALIBR),
    "camera, ros": Reader(read_cameras, "info.yaml", ROS),
    "camera, metashape": Reader(read_cameras, "camera.xml", METASHAPE),
    "camera, opencv": Reader(read_cameras, "opencv.yml", OPENCV),
    "camera, camodocal": Reader(read_cameras, "camodocal.yaml", CAMODOCAL),
    "camera, colmap": Reader(read_cameras, "cameras.txt", "1 OPENCV_FISHEYE 640 480 280 281 320 240 0.01 0 0 0\n"),
    "corners": Reader(lambda path: read_corners(path, (640, 480), 1, fixed=True), "corners.csv", CORNERS),
    "extrinsics": Reader(lambda path: read_mounting_task(path.parent), "extrinsics.yaml", EXTRINSICS),
    "intrinsics": Reader(lambda path: read_intrinsics(path.parent), "intrinsics.yaml", INTRINSICS),
    "layout": Reader(read_layout, "layout.yaml", LAYOUT),
    "config": Reader(read_config, "config.yaml", "detection: {max_range: 3.0}\nface_fit: {iterations: 4}\n"),
    "tracker config": Reader(read_tracker_config, "config.yaml", "tracker: {gate: {probability: 0.99}}\n"),
    "journal": Reader(
        take_up,
        JOURNAL,
        f"{json.dumps(asdict(RUN))}\n"
        + json.dumps({"number": 1, "entry": {"measurements": [ROW], "refusals": []}})
        + '\n{"number": 0, "entry": {"skipped": "damaged"}}\n',
    ),
    "status": Reader(
        resume,
        STATUS,
        json.dumps(
            {"complete": True, "shots": 2, "done": 2, "skipped": [], "source": "a", "run": asdict(RUN)}, indent=2
        ),
        {MEASUREMENTS: "", REFUSALS: ""},
    ),
    "snapshot": Reader(restore, "snapshot.json", snapshot()),
    "jpeg": Reader(read_image, "a.jpg", picture(".jpg")),
    "png": Reader(read_image, "a.png", picture(".png")),
}
"""Readers by what they read."""
ENOUGH = settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])


def holds(reader: Reader, folder: Path, seed: int | None) -> None:
    """Read a damaged file; an error that is not the project's goes on to the test."""
    content = reader.content.encode() if isinstance(reader.content, str) else reader.content
    for name, text in {**reader.beside, reader.name: ""}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    if reader.name != JOURNAL:
        (folder / JOURNAL).unlink(missing_ok=True)
    path = folder / reader.name
    path.write_bytes(content if seed is None else damaged(content, seed))
    said = ""
    try:
        reader.read(path)
    except PalletLocError as error:
        said = str(error)
    assert seed is not None or not said, said
    assert "\n" not in said
    assert len(said) < 2000


@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_read_or_refused_with_an_error_of_the_project(name: str, tmp_path: Path) -> None:
    holds(READERS[name], tmp_path, None)

    @settings(ENOUGH, max_examples=2 * settings().max_examples)
    @given(st.integers(0, 2**32))
    def drawn(seed: int) -> None:
        holds(READERS[name], tmp_path, seed)

    drawn()


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_five_thousand_damaged_files_are_read_or_refused(name: str, tmp_path: Path) -> None:
    @settings(ENOUGH, max_examples=5000)
    @given(st.integers(0, 2**32))
    def drawn(seed: int) -> None:
        holds(READERS[name], tmp_path, seed)

    drawn()
