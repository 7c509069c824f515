"""
A synthetic scene with its truth
================================

An aisle that never was: a rack with pallets, loads and clutter, drawn from a seed and rendered through a
camera model. Its truth is exact, so it can tell how far off a measurement is, and whether its covariance says
so.
"""

# %%
# A scene, a way of the forklift with the errors of its odometry, a mounting, and a nominal shelf plane that is
# off by up to 3 cm and 0.8 degrees. One shot is rendered when it is asked for.

import matplotlib.pyplot as plt
import numpy as np

from palletloc import Localizer, Mounting, Shot, load_library
from palletloc.drawing.canvas import rgb
from palletloc.evaluation.pose_error import from_measurements, true_faces
from palletloc.evaluation.run_match import match_shot
from palletloc.io.truth import TruePallet
from palletloc.synthetic.aisle import AisleSpec
from palletloc.synthetic.simulation import SimulationSpec, simulate

pallet = load_library()["epal1-1200"]
simulation = simulate(SimulationSpec(AisleSpec(models=(pallet,)), width=1920, shots=5), seed=2)
time = float(simulation.times[2])
image = simulation.image(2)

figure, axes = plt.subplots(figsize=(9, 4.5), layout="constrained")
axes.imshow(rgb(image))
axes.set(title=f"{image.shape[1]} x {image.shape[0]}, rendered", xlabel="u / px", ylabel="v / px")

# %%
# Localized like any other shot:

shot = Shot(image, simulation.camera, Mounting(simulation.recorded_mounting), time)
found = Localizer([pallet]).localize(shot, simulation.shelf.seen_from(simulation.odometry.pose_at(time)))

# %%
# The true pallets as the forklift sees them, those that count as visible, and the errors of the measurements
# that belong to them: depth into the pallet, along its front, up, and yaw.

mounting = simulation.forklift_from_camera
placed = [TruePallet(drawn.name, drawn.model.name, drawn.world_from_pallet) for drawn in simulation.aisle.pallets]
faces = true_faces(placed, {pallet.name: pallet.width}, simulation.truth.pose_at(time), mounting)
compared = match_shot(time, from_measurements(found), faces)
for error in compared.errors:
    print(
        f"{error.face.id:>3}, {error.face.range:.1f} m away, {error.face.below:.1f} m below the camera: "
        f"depth {1e3 * error.depth:+.0f}, along {1e3 * error.along:+.0f}, up {1e3 * error.height:+.0f} mm, "
        f"yaw {np.degrees(error.yaw):+.2f} deg, squared in sigmas {error.nees:.1f}"
    )
print(f"missed: {[face.id for face in compared.missed]}, false: {len(compared.false)}")

# %%
# In numbers of their own sigmas, four errors squared add up to 4 on average if the covariance tells the truth.
# From above, with the covariances ten times enlarged:

figure, axes = plt.subplots(figsize=(9, 4.2), layout="constrained")
for face in faces:
    if face.visible:
        ends = face.forklift_from_pallet.transform().apply([[0, -pallet.width / 2, 0], [0, pallet.width / 2, 0]])
        axes.plot(ends[:, 0], ends[:, 1], color="0.6", linewidth=5, solid_capstyle="butt")
circle = np.stack([np.cos(np.linspace(0, 2 * np.pi, 60)), np.sin(np.linspace(0, 2 * np.pi, 60))])
for measured in found:
    pose = measured.forklift_from_pallet
    ends = pose.transform().apply([[0, -pallet.width / 2, 0], [0, pallet.width / 2, 0]])
    axes.plot(ends[:, 0], ends[:, 1], color="tab:red", linewidth=1)
    ellipse = 10 * np.linalg.cholesky(measured.covariance[:2, :2]) @ circle
    axes.plot(pose.x + ellipse[0], pose.y + ellipse[1], color="tab:red", linewidth=1)
axes.plot(*mounting.translation[:2], "k^")
axes.set(
    aspect="equal", xlabel="x / m", ylabel="y / m", title="true fronts (grey), measured (red), camera (triangle)"
)
plt.show()
