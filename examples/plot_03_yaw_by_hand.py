"""
Yaw from the horizontal plane, by hand
======================================

The heading of a pallet shows as the slope of a line, once the image is read on the right plane. A start that
is 20 cm too far away changes the place of the line, but not its slope.
"""

# %%
# A pallet on the floor, from the sample, and its true pose, which is used to make starts and to tell how far
# off the results are.

from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from palletloc.drawing.canvas import show_view
from palletloc.evaluation.pose_error import true_faces
from palletloc.geometry import LevelPose
from palletloc.io.recording import read_recording
from palletloc.io.truth import read_truth
from palletloc.measurement import Reason, YawSource
from palletloc.paper.horizontal_view import HorizontalView, YawConfig, view_horizontal
from palletloc.paper.yaw import find_lines, measure_line, measure_yaw

sample = Path(str(files("palletloc") / "sample"))
recording, truth = read_recording(sample), read_truth(sample)
shot = recording.shot(recording.shots[3])
pallet = recording.models[0]
mounting = recording.forklift_from_camera
faces = true_faces(truth.pallets, {pallet.name: pallet.width}, truth.forklift.pose_at(shot.time), mounting)
true = next(face.forklift_from_pallet for face in faces if face.visible and face.below > 1.0)


def shifted(along_ray: float, turn_deg: float) -> LevelPose:
    """Return a start that is off along the viewing ray and in yaw; its height is known."""
    point = np.array([true.x, true.y, true.z])
    ray = point - mounting.translation
    x, y, _ = point + along_ray * ray / np.linalg.norm(ray)
    return LevelPose(float(x), float(y), true.z, true.yaw + float(np.radians(turn_deg)))


# %%
# The plane through the lower edge, placed by a start that is turned by 3.1 degrees and 20 cm too far away. Its
# centre line (dotted) is where the edge would be if the start were right.

config = YawConfig(search=0.3)


def look(pose: LevelPose) -> HorizontalView:
    return view_horizontal(shot, pose, pallet, YawSource.BOTTOM, config)


def show(seen: HorizontalView, slope: float, up: float, title: str) -> None:
    _, axes = plt.subplots(figsize=(9, 5.2), layout="constrained")
    show_view(axes, seen.view)
    right = np.array(axes.get_xlim())
    axes.axhline(0.0, color="w", linestyle=":", linewidth=1)
    axes.plot(right, up + slope * right, color="red", linewidth=1)
    axes.set(title=title, xlabel="right / m", ylabel="up / m")


start = shifted(0.20, 3.1)
seen = look(start)
line = find_lines(seen, config)[0]
show(seen, float(np.tan(line.turn)), line.up, "as the start places the plane, with the longest line")

# %%
# A Hough transform found that line; its angle has steps. A robust line through the peaks of the gradient, one
# for each cut across it, measures it to a fraction of a pixel. The plane placed again shows the line level.

fit = measure_line(shot, seen, line, pallet, config)
slope = float(np.tan(line.turn)) if fit is None else fit.slope
turned = replace(start, yaw=start.yaw + float(np.arctan(slope)))
show(look(turned), 0.0, line.up, "placed again with the measured yaw")
for name, yaw in (("start", start.yaw), ("Hough", start.yaw + line.turn), ("gradient peaks", turned.yaw)):
    print(f"{name:>15}: {np.degrees(yaw - true.yaw):+.3f} deg")

# %%
# The start's distance hardly matters: a pallet that moves along its viewing ray changes the place of the line
# and its length, not its slope.

for along_ray in (-0.2, 0.0, 0.2, 0.4):
    seen = look(shifted(along_ray, 3.1))
    line = find_lines(seen, config)[0]
    fit = measure_line(shot, seen, line, pallet, config)
    turn = line.turn if fit is None else float(np.arctan(fit.slope))
    print(f"{100 * along_ray:+4.0f} cm along the ray: {3.1 + np.degrees(turn):+.3f} deg")

# %%
# When the position is known, too (here: the true one), every level line of the face can be measured where it
# appears on the plane. They vote, each with its own sigma.

estimate = measure_yaw(shot, look(replace(true, yaw=turned.yaw)), turned, pallet, config)
if not isinstance(estimate, Reason):
    for vote in estimate.votes:
        off = np.degrees(turned.yaw + vote.turn - true.yaw)
        print(f"{vote.edge.kind:>15}: {off:+.3f} deg, sigma {np.degrees(vote.sigma):.3f}")
    print(f"{'together':>15}: {np.degrees(estimate.yaw - true.yaw):+.3f} deg")
plt.show()
