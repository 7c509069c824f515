"""
Yaw from the horizontal plane, by hand
======================================

The heading of a pallet shows as the slope of a line, once the image is read on the right plane. A start that is
20 cm too far away changes the place of the line, but not its slope.
"""

# %%
# A pallet on the floor, from the sample, and a start that is well off: 3 degrees turned, and 20 cm too far along the
# viewing ray. The truth comes with the sample; only the last line of output uses it.

from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np

from palletloc.config import YawConfig
from palletloc.evaluation.errors import true_faces
from palletloc.geometry import LevelPose
from palletloc.horizontal_view import HorizontalView, view_horizontal
from palletloc.io.recording import read_recording
from palletloc.io.truth import read_truth
from palletloc.measurement import YawSource
from palletloc.projection import Projector
from palletloc.yaw import YawEstimate, find_lines, measure_line, measure_yaw

sample = Path(str(files("palletloc") / "sample"))
recording, truth = read_recording(sample), read_truth(sample)
shot = recording.shots[3]
image = recording.image(shot)
pallet = recording.models[0]
faces = true_faces(
    truth.pallets, {pallet.name: pallet.width}, truth.forklift.pose_at(shot.time), recording.forklift_from_camera
)
true = next(face.forklift_from_pallet for face in faces if face.visible and face.below > 1.0)

camera = np.asarray(recording.forklift_from_camera.translation)
point = np.array([true.x, true.y, true.z])
ray = (point - camera) / np.linalg.norm(point - camera)
x, y, _ = point + 0.20 * ray
start = LevelPose(float(x), float(y), true.z, true.yaw + np.radians(3.0))

# %%
# The plane through the lower edge at the start. Its centre line is where the edge would be if the start were right.

projector, config = Projector(recording.camera), replace(YawConfig(), search=0.25)
camera_from_forklift = recording.forklift_from_camera.inv()


def look(pose: LevelPose) -> HorizontalView:
    return view_horizontal(
        projector, image, camera_from_forklift, pose, pallet, YawSource.BOTTOM, config
    )


def show(seen: HorizontalView, slope: float, up: float, title: str) -> None:
    grid = seen.view.grid
    right = np.array([grid.left, grid.left + (grid.columns - 1) * grid.resolution])
    bottom = grid.top - (grid.rows - 1) * grid.resolution
    figure, axes = plt.subplots(figsize=(9, 4.2), layout="constrained")
    axes.imshow(cv2.cvtColor(seen.view.image, cv2.COLOR_BGR2RGB), extent=(*right, bottom, grid.top))
    axes.axhline(0.0, color="w", linestyle=":", linewidth=1)
    axes.plot(right, up + slope * right, color="red", linewidth=1)
    axes.set(title=title, xlabel="right / m", ylabel="up / m")


# %%
# A Hough transform finds the boundary line; its angle has steps. A robust line through the peaks of the gradient, one
# for each cut across the line, measures it to a fraction of a pixel. Here the longest line is taken.

first = look(start)
line = find_lines(first, config)[0]
fit = measure_line(projector, first, line, pallet, config)
slope = np.tan(line.turn) if fit is None else fit.slope
show(first, slope, line.up, "as the start places the plane")
turned = replace(start, yaw=start.yaw + float(np.arctan(slope)))
for name, yaw in (
    ("start", start.yaw),
    ("Hough transform", start.yaw + line.turn),
    ("line through gradient peaks", turned.yaw),
):
    print(f"{name}: {np.degrees(yaw - true.yaw):+.3f} deg off")
