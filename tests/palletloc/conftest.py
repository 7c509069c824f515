from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

RECORDING = """\
format: 1
camera: {model: equirectangular, width: 64, height: 32}
forklift_from_camera: {translation_m: [0.3, -0.1, 1.8], roll_pitch_yaw_deg: [0, 0, 0]}
shelf: {point_m: [3.0, 2.0], facing_deg: -90.0, levels_m: [0.0]}
pallets: [t11]
"""
SHOTS = "time_s,file\n" + "".join(f"{0.5 * n},images/{n}.png\n" for n in range(4))
ODOMETRY = """\
time_s,x_m,y_m,yaw_rad,speed_mps,yaw_rate_radps
0.0,0.0,0.0,0.0,0.4,0.1
1.0,0.4,0.0,0.1,0.4,0.1
2.0,0.8,0.0,0.2,0.4,0.1
"""


@pytest.fixture
def blank_recording(tmp_path: Path) -> Path:
    """Return a recording of four shots with nothing to see, written without the code under test."""
    folder = tmp_path / "approach"
    (folder / "images").mkdir(parents=True)
    for name, text in {"recording.yaml": RECORDING, "shots.csv": SHOTS, "odometry.csv": ODOMETRY}.items():
        (folder / name).write_text(text)
    for number in range(4):
        image = np.full((32, 64, 3), 100 + number, np.uint8)
        (folder / "images" / f"{number}.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())
    return folder
