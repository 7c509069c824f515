"""
The pallets of one shot
=======================

From an image to poses in ten lines, and a look at what became of every candidate.
"""

# %%
# A localizer belongs to a camera, its mounting and the pallets to look for. It holds no other state, so shots
# may come in any order.

from importlib.resources import files
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from palletloc.drawing.canvas import rgb
from palletloc.drawing.outline import place_outline, project_line
from palletloc.io.recording import read_recording
from palletloc.localizer import Localizer

recording = read_recording(Path(str(files("palletloc") / "sample")))
localizer = Localizer(recording.camera, recording.mounting, recording.models)

shot = recording.shots[3]
image = recording.image(shot)
shelf = recording.shelf.seen_from(recording.odometry.pose_at(shot.time))
found = localizer.localize(image, shot.time, shelf, shot.file)

# %%
# Each measurement is a level pose in the forklift frame with its covariance. The yaw is the heading that the
# forklift has when it inserts its forks.

for one in found:
    pose, sigma = one.forklift_from_pallet, np.sqrt(np.diag(one.covariance))
    print(
        f"{one.model}: x {pose.x:.3f} m ({1e3 * sigma[0]:.0f} mm), y {pose.y:.3f} m ({1e3 * sigma[1]:.0f} mm), "
        f"z {pose.z:.3f} m ({1e3 * sigma[2]:.0f} mm), yaw {np.degrees(pose.yaw):.2f} deg "
        f"({np.degrees(sigma[3]):.2f} deg) from {one.yaw_from}"
    )

# %%
# The fronts, drawn where the poses put them in the image:

camera_from_forklift = recording.forklift_from_camera.inv()
pixels = []
for one in found:
    for line in place_outline(localizer.models[one.model], one.forklift_from_pallet):
        pixels += project_line(recording.camera, camera_from_forklift, line)
left, top = np.concatenate(pixels).min(axis=0) - 60
right, bottom = np.concatenate(pixels).max(axis=0) + 60

figure, axes = plt.subplots(figsize=(9, 6), layout="constrained")
axes.imshow(rgb(image))
for piece in pixels:
    axes.plot(*piece.T, color="lime", linewidth=1)
axes.set(xlim=(left, right), ylim=(bottom, top), xlabel="u / px", ylabel="v / px", title="measured fronts")

# %%
# `explain` does the same and keeps everything. Most candidates are edges of beams and cartons, or a pallet
# shifted by an opening; each is given up with a reason.

explained = localizer.explain(image, shot.time, shelf, shot.file)
reasons = [f"{refusal.stage}: {refusal.reason}" for refusal in explained.refusals]
for reason in sorted(set(reasons)):
    print(f"{reasons.count(reason):3} {reason}")
plt.show()
