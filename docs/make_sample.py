"""Make the sample recording that ships with the package from a larger recording of the same approach.

    python docs/make_sample.py SOURCE OUT

A few shots are kept, with the whole odometry and the truth. Nothing is scaled: the shelf's part of each image
stays as it is, the rest (ceiling, far side of the aisle, rear) is blurred, which saves most of the bytes.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from palletloc.geometry import FloatArray, Image
from palletloc.io.images import write_image
from palletloc.io.recording import Recording, read_recording, write_recording
from palletloc.io.truth import Truth, read_truth
from palletloc.trajectory import Trajectory

SHOTS = (0, 4, 8, 12, 16, 19)
"""Which shots of the source are kept."""
COLUMNS, ROWS = (0.14, 0.53), (0.31, 0.80)
"""The part of the image that stays sharp: from the left border and from the upper one, 0 to 1."""
FADE, BLUR = 0.012, 0.007
"""Width of the transition and sigma of the blur, in parts of the image's height."""
QUALITY = 95
"""Of the JPEG images."""


def main(source: Path, out: Path) -> None:
    """Write the sample.

    Parameters
    ----------
    source : Path
        A recording with truth.
    out : Path
        Folder of the sample: new, or empty.
    """
    recording, truth = read_recording(source), read_truth(source)
    shots = tuple(recording.shots[number] for number in SHOTS)
    sample = replace(recording, shots=shots)
    blank = np.zeros((recording.camera.height, recording.camera.width, 3), np.uint8)
    write_recording(out, sample, [blank] * len(shots), cut(truth, sample))
    weight = sharpness(recording.camera.width, recording.camera.height)
    for shot in shots:
        write_image(out / shot.file, blurred_outside(recording.image(shot), weight), quality=QUALITY)


def cut(truth: Truth, sample: Recording) -> Truth:
    """Return the truth of the sample's shots only."""
    poses = np.array([truth.forklift.pose_at(shot.time).as_array() for shot in sample.shots])
    times = np.array([shot.time for shot in sample.shots])
    x, y, z, yaw = poses.T
    return replace(truth, forklift=Trajectory(times, x, y, yaw, z))


def sharpness(width: int, height: int) -> FloatArray:
    """Return how much of the original each pixel keeps, (height, width, 1), 0 to 1."""
    mask = np.zeros((height, width))
    (left, right), (top, bottom) = COLUMNS, ROWS
    mask[round(top * height) : round(bottom * height), round(left * width) : round(right * width)] = 1.0
    return np.asarray(cv2.GaussianBlur(mask, (0, 0), FADE * height), dtype=np.float64)[..., None]


def blurred_outside(image: Image, weight: FloatArray) -> Image:
    """Return an image that is sharp where the weight is 1 and blurred where it is 0."""
    soft = cv2.GaussianBlur(image, (0, 0), BLUR * image.shape[0])
    return np.asarray(np.rint(weight * image + (1 - weight) * soft), dtype=np.uint8)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
