"""
Metric views of planes
======================

A 360-degree image bends every straight line. Read on a plane, it becomes a metric image: lines are straight
again, and a pixel is a known length.

Two planes matter for a pallet: the vertical one of its front face, and the horizontal one through its lower
edge.
"""

# %%
# A shot of the sample recording, with what is known before any pallet is measured: the camera, its mounting,
# and the nominal front plane of the shelf, which odometry carries to the time of the shot.

from importlib.resources import files
from pathlib import Path

import matplotlib.pyplot as plt

from palletloc.drawing.canvas import rgb, show_view
from palletloc.geometry import LevelPose
from palletloc.io.recording import read_recording
from palletloc.plane import PALLET_FROM_HORIZONTAL, PALLET_FROM_VERTICAL, PlaneGrid
from palletloc.projection import Projector

recording = read_recording(Path(str(files("palletloc") / "sample")))
shot = recording.shots[2]
image = recording.image(shot)
shelf = recording.shelf.seen_from(recording.odometry.pose_at(shot.time))

figure, axes = plt.subplots(figsize=(9, 4.5), layout="constrained")
axes.imshow(rgb(image), extent=(-0.5, image.shape[1] - 0.5, image.shape[0] - 0.5, -0.5))
axes.set(title=f"{shot.file}, {shot.time:.2f} s", xlabel="u / px", ylabel="v / px")

# %%
# The shelf's front plane
# -----------------------
#
# A plane is placed by a pose: here that of a pallet that would stand at the nominal plane's given point. What
# the view shows of the plane itself is to scale; everything before or behind it is not.

forklift_from_pallet = LevelPose(shelf.x, shelf.y, 0.0, shelf.yaw)
camera_from_forklift = recording.forklift_from_camera.inv()
projector = Projector(recording.camera)
front = projector.view(
    image,
    camera_from_forklift * forklift_from_pallet.transform() * PALLET_FROM_VERTICAL,
    PlaneGrid.spanning(-2.5, 2.5, -0.2, 2.0, resolution=0.005),
)
figure, axes = plt.subplots(figsize=(9, 4.4), layout="constrained")
show_view(axes, front)
axes.set(title="nominal front plane of the shelf, 5 mm per pixel", xlabel="right / m", ylabel="up / m")

# %%
# The horizontal plane
# --------------------
#
# A plane at the height of the floor, as if seen from above, with the aisle below. The lower edges of the
# pallets on the floor lie on it: they are straight, in their true place and direction. Whatever rises above the
# plane leans away from the camera.

floor = projector.view(
    image,
    camera_from_forklift * forklift_from_pallet.transform() * PALLET_FROM_HORIZONTAL,
    PlaneGrid.spanning(-2.5, 2.5, -1.0, 1.0, resolution=0.005),
)
figure, axes = plt.subplots(figsize=(9, 4.0), layout="constrained")
show_view(axes, floor)
axes.set(title="horizontal plane at the height of the floor", xlabel="right / m", ylabel="up / m")
axes.axhline(0.0, color="w", linestyle=":", linewidth=1)

# %%
# The dotted line is the nominal plane. The pallets stand a little before or behind it, and they are turned
# against it: that is what there is to measure.

plt.show()
