"""
Metric views of planes
======================

A pallet's heading shows as the slope of a line, once the image is read on the right plane.

Two plane views of one 360-degree image are read here: of the vertical plane where the pallet is expected, and
of the horizontal plane through its lower edge. The pallet is turned by 8 degrees against the expectation.
"""

# %%
# An image to read: a camera 1.6 m above the pallet's underside sees the front face of a pallet with a carton
# on it, and the floor that it stands on. Every pixel's ray is cut with the face's plane and with the floor.

import matplotlib.pyplot as plt
import numpy as np

from palletloc.cameras import Equirectangular
from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.pallet_library import load_library
from palletloc.plane import PALLET_FROM_HORIZONTAL, PALLET_FROM_VERTICAL, PlaneGrid
from palletloc.projection import Projector

camera = Equirectangular(3840, 1920)
pallet = load_library()["epal1-1200"]
camera_from_pallet = LevelPose(1.9, 0.5, -1.6, np.radians(8.0))


def paint(rays_pallet: FloatArray, origin_pallet: FloatArray) -> Image:
    with np.errstate(divide="ignore"):
        to_face = -origin_pallet[0] / rays_pallet[..., 0]
        to_floor = -origin_pallet[2] / rays_pallet[..., 2]
    face = origin_pallet + to_face[..., None] * rays_pallet
    right, up = -face[..., 1], face[..., 2]
    image = np.full(right.shape, 150, np.uint8)  # walls
    image[to_floor > 0] = 105
    on_face = (to_face > 0) & (np.abs(right) < pallet.width / 2) & (up > 0)
    image[on_face & (up < 0.9)] = 190  # the carton, and the pallet below it
    image[on_face & (up < pallet.height)] = 230
    for opening in pallet.openings:
        across = np.abs(right - opening.center) < opening.width / 2
        image[on_face & across & (up > opening.bottom) & (up < opening.bottom + opening.height)] = 40
    return image


columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
rays = camera.unproject(np.stack([columns, rows], -1).astype(float)).directions
pallet_from_camera = camera_from_pallet.transform().inv()
rays_pallet = pallet_from_camera.rotation.apply(rays.reshape(-1, 3)).reshape(rays.shape)
image = paint(rays_pallet, pallet_from_camera.translation)

figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
axes.imshow(image, cmap="gray", vmin=0, vmax=255)
axes.set(title="the 360-degree image", xlabel="u / px", ylabel="v / px")

# %%
# Where the pallet is expected: at the right place, but not turned. The planes are placed by this pose.

expected = LevelPose(camera_from_pallet.x, camera_from_pallet.y, camera_from_pallet.z, 0.0)
projector = Projector(camera)
vertical = projector.view(
    image,
    expected.transform() * PALLET_FROM_VERTICAL,
    PlaneGrid.spanning(-0.9, 0.9, -0.2, 0.5, resolution=0.004),
)
horizontal = projector.view(
    image,
    expected.transform() * PALLET_FROM_HORIZONTAL,
    PlaneGrid.spanning(-0.9, 0.9, -0.35, 0.35, resolution=0.004),
)

figure, (upper, lower) = plt.subplots(2, 1, figsize=(8, 7), layout="constrained")
for axes, view, title in (
    (upper, vertical, "vertical plane: the face as the forks meet it, distorted by its turn"),
    (lower, horizontal, "horizontal plane through the lower edge: the turn is the slope"),
):
    grid = view.grid
    extent = (
        grid.left,
        grid.left + grid.columns * grid.resolution,
        grid.top - grid.rows * grid.resolution,
        grid.top,
    )
    axes.imshow(view.image, cmap="gray", vmin=0, vmax=255, extent=extent)
    axes.set(title=title, xlabel="right / m", ylabel="up / m")

# %%
# In the horizontal view, only what lies on the plane keeps its shape, and the lower edge does: it crosses the
# origin at the angle between the expected heading and the true one (dashed). A turn to the left, which is a
# positive yaw, makes the line climb to the right.

right = np.array([-pallet.width / 2, pallet.width / 2])
lower.plot(right, np.tan(camera_from_pallet.yaw) * right, "r--", linewidth=1)
lower.plot(right, 0 * right, "w:", linewidth=1)
plt.show()
