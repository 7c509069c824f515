"""The refinement on one pallet of the sample: hypotheses around a start that is off, then profiles across edges."""

from importlib.resources import files
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from scipy.ndimage import gaussian_filter1d

from palletloc.candidate import Fit
from palletloc.drawing.canvas import show_view
from palletloc.drawing.outline import face_outline
from palletloc.face import EdgeKind
from palletloc.geometry import LevelPose
from palletloc.io.recording import read_recording
from palletloc.localizer import Localizer
from palletloc.measurement import HeightPrior, YawSource
from palletloc.refinement.hypotheses import SearchConfig
from palletloc.refinement.search import Search, search

REACH, PIXEL = 0.022, 0.004
"""How far the profiles go to each side of an edge, and about the size of a pixel of the image there, in metres."""

recording = read_recording(Path(str(files("palletloc") / "sample")))
shot = recording.shot(recording.shots[3])
image = shot.image
outcomes = Localizer(recording.models).explain(shot, recording.shelf_at(shot.time)).outcomes
found = next(fit for fit in outcomes if isinstance(fit, Fit) and fit.yaw_from is YawSource.BOTTOM)
model, pose = found.candidate.model, found.pose
camera_from_pallet = recording.forklift_from_camera.inv() * pose.transform()

ray = np.array([pose.x, pose.y]) - recording.mounting.center[:2]
x, y = np.array([pose.x, pose.y]) + 0.25 * ray / np.hypot(*ray)
start = LevelPose(float(x), float(y), pose.z, pose.yaw - float(np.radians(9.0)))
wide = SearchConfig(turn_deg=15.0, nearer=0.5, farther=0.5)
height = HeightPrior(pose.z, 0.003)
looked = search(shot, start, model, height, wide)
figure, axes_of = plt.subplot_mosaic(
    [["above", "plane"], ["table", "table"], ["profiles", "profiles"]], figsize=(8.5, 7.5), layout="constrained"
)
above, plane, table, profiles = (axes_of[name] for name in ("above", "plane", "table", "profiles"))


def label(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", fontsize=10)
    axes.set(xlabel="right / m", ylabel="up / m")


if isinstance(looked, Search):
    patch, scores = looked.patch, looked.found
    for axes in (above, plane):
        show_view(axes, patch.view)
        axes.set(xlim=axes.get_xlim(), ylim=axes.get_ylim())
    plane.images[0].set_data(np.minimum(patch.tensor[0] + patch.tensor[2], 1.0))
    plane.images[0].set(cmap="gray", clim=(0, 1))
    for line in face_outline(model):
        above.plot(*patch.appearing(start, line).T, color="gold", linewidth=1.2)
        for axes in (above, plane):
            axes.plot(*patch.appearing(looked.starts[0][0], line).T, color="lime", linewidth=1.0)
    label(above, "the start (gold), the best hypothesis (green)")
    label(plane, "how much edge there is")
    away = np.hypot(patch.plane_from_camera[0], patch.plane_from_camera[2])
    shifts, turns = 100 * away * (scores.grid.ranges - 1), np.degrees(scores.grid.turns)
    mesh = table.pcolormesh(shifts, turns, scores.score, shading="nearest", rasterized=True)
    figure.colorbar(mesh, ax=table, label="score")
table.set_title("the best score at each distance and yaw, against the start", loc="left", fontsize=10)
table.set(xlabel="away from the camera along the viewing ray / cm", ylabel="yaw / degrees")

along, outward = np.arange(-0.53, 0.53, PIXEL), np.arange(-REACH, REACH, PIXEL / 4)
points = np.stack(np.broadcast_arrays(0.0, -along[:, None], -outward), axis=-1)
seen = recording.camera.project(camera_from_pallet.apply(points.reshape(-1, 3))).pixels.astype(np.float32)
columns, rows = seen.T.reshape(2, *points.shape[:2])
sampled = cv2.remap(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), columns, rows, cv2.INTER_LINEAR).astype(np.float64)
change = np.abs(gaussian_filter1d(gaussian_filter1d(sampled, 0.6 * 4, order=1), 1.0, axis=0))
profiles.pcolormesh(along, 1e3 * outward, change.T, cmap="gray", shading="nearest", rasterized=True)
for measured in found.face.seen.edges if found.face else ():
    if measured.edge.kind is EdgeKind.BOTTOM:
        ends = np.array([-0.5, 0.5]) * measured.edge.length
        offsets = measured.shift.mean + measured.fit.offset + measured.fit.slope * ends
        profiles.plot(ends, 1e3 * offsets, color="lime", linewidth=1.2)
title = "the change of the image across the lower edge, cut by cut, and the line through its peaks"
profiles.set_title(title, loc="left", fontsize=10)
profiles.set(xlabel="along the edge / m", ylabel="outward / mm")
plt.show()
