"""The paper's chain on one pallet of the sample: detection, yaw, position, edges."""

from importlib.resources import files
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from palletloc.candidate import Fit, last_step, steps_of
from palletloc.choices import Method
from palletloc.drawing.canvas import show_view
from palletloc.drawing.face_figure import edge_stretches
from palletloc.drawing.outline import place_outline, seen_on_plane
from palletloc.io.recording import read_recording
from palletloc.localizer import Localizer
from palletloc.measurement import YawSource
from palletloc.paper.boundary import BoundaryLine
from palletloc.paper.horizontal_view import HorizontalView
from palletloc.paper.position import Sweep

recording = read_recording(Path(str(files("palletloc") / "sample")))
shot = recording.shot(recording.shots[3])
localizer = Localizer(recording.models, Method.HORIZONTAL_PLANE)
explained = localizer.explain(shot, recording.shelf_at(shot.time))
found = [outcome for outcome in explained.outcomes if isinstance(outcome, Fit)]
pallet = next(fit for fit in found if fit.yaw_from is YawSource.BOTTOM)
model, start = pallet.candidate.model, pallet.candidate.start
band = next(view for view in explained.shelf_views if abs(view.view.grid.top) < 1.0)


def label(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", fontsize=10)
    axes.set(xlabel="right / m", ylabel="up / m")


figure, (front, above, score, face) = plt.subplots(
    4, 1, figsize=(8.5, 10), layout="constrained", height_ratios=(1.2, 1.0, 0.8, 0.8)
)

show_view(front, band.view)
plane_from_camera = band.view.plane_from_camera
for line in place_outline(model, start):
    points = seen_on_plane(band.forklift_from_plane.inv().apply(line), plane_from_camera)
    front.plot(*points.T, color="gold", linewidth=1.2)
middle = band.forklift_from_plane.inv().apply([start.x, start.y, start.z])[0]
front.set(xlim=(middle - 1.4, middle + 1.4), ylim=(-0.25, 0.6))
label(front, "A  the shelf's nominal plane: a candidate where the template fits")

first = steps_of(pallet, HorizontalView)[0]
show_view(above, first.view)
for boundary in steps_of(pallet, BoundaryLine)[:1]:
    ends = np.array(above.get_xlim())
    above.plot(ends, boundary.up + np.tan(boundary.turn) * ends, color="gold", linewidth=1.2)
above.axhline(0.0, color="w", linestyle=":", linewidth=1)
label(above, "B  the horizontal plane through the lower edge: the slope of the line is the error of the yaw")

sweep = last_step(pallet, Sweep)
if sweep is not None:
    score.plot(100 * sweep.depth, sweep.score, color="tab:blue")
score.grid(color="0.9")
score.set_title("C  the sweep: agreement of the template over the distance", loc="left", fontsize=10)
score.set(xlabel="shift of the plane away from the camera / cm", ylabel="score")

if pallet.face is not None:
    half = model.width / 2 + 0.06
    show_view(face, shot.vertical_view(pallet.pose, (-half, half, -0.06, model.height + 0.06), 0.002))
    for measured in pallet.face.seen.edges:
        for ends in edge_stretches(measured, model):
            face.plot(*ends.T, color="lime", linewidth=1.2)
label(face, "fit  the front face at its pose, with the lines that were measured")
plt.show()
