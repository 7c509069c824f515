"""Where an image shows a rounded edge, against the drawn one."""

import matplotlib.pyplot as plt
import numpy as np

from palletloc.face import EdgeKind, FaceEdge, edge_shift
from palletloc.pallet import Opening, PalletModel

RADIUS = 0.010
TITLES = {EdgeKind.SIDE: "a side of the outline or of an opening", EdgeKind.BOTTOM: "the lower edge of the outline"}
model = PalletModel(
    "round", 1.1, 0.144, 1.1, (Opening(-0.265, 0.024, 0.29, 0.092), Opening(0.265, 0.024, 0.29, 0.092)), 0.0, RADIUS
)
angles = np.radians(np.linspace(-65, 65, 261))

figure, panels = plt.subplots(1, len(TITLES), figsize=(9, 3.2), sharey=True, layout="constrained")
for axes, (kind, title) in zip(panels, TITLES.items(), strict=True):
    edge = FaceEdge(kind, (-0.5, 0.0), (0.5, 0.0), (0.0, -1.0))
    shifts = [edge_shift(edge, np.array([0.0, -np.tan(angle), 1.0]), model) for angle in angles]
    mean, sigma = (np.array([getattr(shift, name) for shift in shifts]) * 1e3 for name in ("mean", "sigma"))
    degrees = np.degrees(angles)
    axes.fill_between(degrees, mean - sigma, mean + sigma, color="tab:blue", alpha=0.2, linewidth=0)
    axes.plot(degrees, mean, color="tab:blue")
    axes.axvline(0.0, color="0.7", linewidth=0.8)
    axes.axhline(0.0, color="0.7", linewidth=0.8)
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("hidden \N{LEFTWARDS ARROW} adjoining surface \N{RIGHTWARDS ARROW} seen, in deg", fontsize=8)
panels[0].set_ylabel("shift out of the solid / mm")
plt.show()
