"""The paper's chain on one pallet of the sample: detection, yaw, position, edges."""

from importlib.resources import files
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from palletloc.choices import Method
from palletloc.drawing.canvas import show_view
from palletloc.drawing.face_figure import edge_stretches
from palletloc.drawing.outline import place_outline, seen_on_plane
from palletloc.face_view import view_face
from palletloc.io.recording import read_recording
from palletloc.localizer import Localizer
from palletloc.measurement import Reason, YawSource

recording = read_recording(Path(str(files("palletloc") / "sample")))
shot = recording.shots[3]
localizer = Localizer(recording.camera, recording.mounting, recording.models, Method.HORIZONTAL_PLANE)
shelf = recording.shelf.seen_from(recording.odometry.pose_at(shot.time))
image = recording.image(shot)
explained = localizer.explain(image, shot.time, shelf)
found = [one for one in explained.candidates if one.refusal is None]
pallet = next(one for one in found if one.yaw_from is YawSource.BOTTOM)
band = next(view for view in explained.shelf_views if abs(view.view.grid.top) < 1.0)


def label(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", fontsize=10)
    axes.set(xlabel="right / m", ylabel="up / m")


figure, (front, above, score, face) = plt.subplots(
    4, 1, figsize=(8.5, 10), layout="constrained", height_ratios=(1.2, 1.0, 0.8, 0.8)
)

show_view(front, band.view)
plane_from_camera = np.asarray(band.view.camera_from_plane.inv().translation)
for line in place_outline(pallet.model, pallet.start):
    points = seen_on_plane(band.forklift_from_plane.inv().apply(line), plane_from_camera)
    front.plot(*points.T, color="gold", linewidth=1.2)
middle = band.forklift_from_plane.inv().apply([pallet.start.x, pallet.start.y, pallet.start.z])[0]
front.set(xlim=(middle - 1.4, middle + 1.4), ylim=(-0.25, 0.6))
label(front, "A  the shelf's nominal plane: a candidate where the template fits")

first = pallet.horizontal[0]
show_view(above, first.view)
for boundary in pallet.lines[:1]:
    ends = np.array(above.get_xlim())
    above.plot(ends, boundary.up + np.tan(boundary.turn) * ends, color="gold", linewidth=1.2)
above.axhline(0.0, color="w", linestyle=":", linewidth=1)
label(above, "B  the horizontal plane through the lower edge: the slope of the line is the error of the yaw")

if pallet.sweep is not None:
    score.plot(100 * pallet.sweep.depth, pallet.sweep.score, color="tab:blue")
score.grid(color="0.9")
score.set_title("C  the sweep: agreement of the template over the distance", loc="left", fontsize=10)
score.set(xlabel="shift of the plane away from the camera / cm", ylabel="score")

if pallet.face is not None and pallet.pose is not None:
    camera_from_forklift = recording.forklift_from_camera.inv()
    seen = view_face(localizer.projector, image, camera_from_forklift, pallet.pose, pallet.model, 0.002)
    if not isinstance(seen, Reason):
        show_view(face, seen)
    for measured in pallet.face.seen.edges:
        for ends in edge_stretches(measured, pallet.model):
            face.plot(*ends.T, color="lime", linewidth=1.2)
label(face, "fit  the front face at its pose, with the lines that were measured")
plt.show()
