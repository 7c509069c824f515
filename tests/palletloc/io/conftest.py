from pathlib import Path

import cv2
import numpy as np
import pytest

RECORDING = """\
format: 1
camera: {model: equirectangular, width: 64, height: 32}
forklift_from_camera: {translation_m: [0.3, -0.1, 1.8], roll_pitch_yaw_deg: [-0.7, 0.9, -1.2]}
shelf:
  point_m: [3.0, 2.0]
  facing_deg: -90.0
  levels_m: [0.0, 1.55]
pallets: [mine, epal1-1200]
"""
PALLETS = """\
mine:
  width_m: 1.1
  height_m: 0.144
  depth_m: 1.1
  openings:
  - {center_m: -0.265, bottom_m: 0.024, width_m: 0.29, height_m: 0.092}
  - {center_m: 0.265, bottom_m: 0.024, width_m: 0.29, height_m: 0.092}
"""
SHOTS = "time_s,file\n0.0,images/0.png\n0.5,images/1.png\n1.0,images/2.png\n"
ODOMETRY = """\
time_s,x_m,y_m,yaw_rad,speed_mps,yaw_rate_radps
0.0,0.0,0.0,0.0,0.4,0.1
0.5,0.2,0.0,0.05,0.4,0.1
1.0,0.4,0.0,0.1,0.4,0.1
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a small recording, written without the code under test."""
    folder = tmp_path / "approach"
    (folder / "images").mkdir(parents=True)
    texts = {"recording.yaml": RECORDING, "pallets.yaml": PALLETS, "shots.csv": SHOTS, "odometry.csv": ODOMETRY}
    for name, text in texts.items():
        (folder / name).write_text(text)
    rng = np.random.default_rng(1)
    for number in range(3):
        image = rng.integers(0, 256, (32, 64, 3), dtype=np.uint8)
        (folder / "images" / f"{number}.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())
    return folder
