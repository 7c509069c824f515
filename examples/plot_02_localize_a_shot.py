"""
The pallets of one shot
=======================

From an image to poses in ten lines, and a look at what became of every candidate.
"""

# %%
# A shot is an image with its camera, the camera's mounting and its time. A localizer belongs to the pallets to look
# for; it holds no state, so shots may come in any order.

from importlib.resources import files
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from palletloc import Localizer, read_recording
from palletloc.drawing.canvas import rgb
from palletloc.drawing.outline import place_outline, project_line

recording = read_recording(Path(str(files("palletloc") / "sample")))
localizer = Localizer(recording.models)

shot = recording.shot(recording.shots[3])
shelf = recording.shelf_at(shot.time)
found = localizer.localize(shot, shelf)

# %%
# Each measurement is a level pose in the forklift frame with its covariance. The yaw is the heading that the
# forklift has when it inserts its forks.

for measurement in found:
    pose, sigma = measurement.forklift_from_pallet, np.sqrt(np.diag(measurement.covariance))
    print(
        f"{measurement.model}: x {pose.x:.3f} m ({1e3 * sigma[0]:.0f} mm), "
        f"y {pose.y:.3f} m ({1e3 * sigma[1]:.0f} mm), z {pose.z:.3f} m ({1e3 * sigma[2]:.0f} mm), "
        f"yaw {np.degrees(pose.yaw):.2f} deg ({np.degrees(sigma[3]):.2f} deg) from {measurement.yaw_from}"
    )

# %%
# The fronts, drawn where the poses put them in the image:

pixels = []
for measurement in found:
    for line in place_outline(localizer.models[measurement.model], measurement.forklift_from_pallet):
        pixels += project_line(shot.camera, shot.mounting.to_camera, line)
left, top = np.concatenate(pixels).min(axis=0) - 60
right, bottom = np.concatenate(pixels).max(axis=0) + 60

figure, axes = plt.subplots(figsize=(9, 6), layout="constrained")
axes.imshow(rgb(shot.image))
for piece in pixels:
    axes.plot(*piece.T, color="lime", linewidth=1)
axes.set(xlim=(left, right), ylim=(bottom, top), xlabel="u / px", ylabel="v / px", title="measured fronts")

# %%
# `explain` does the same and keeps everything. Most candidates are edges of beams and cartons, or a pallet
# shifted by an opening; each is given up with a reason.

explained = localizer.explain(shot, shelf)
reasons = [f"{refusal.stage}: {refusal.reason}" for refusal in explained.refusals]
for reason in sorted(set(reasons)):
    print(f"{reasons.count(reason):3} {reason}")
plt.show()
