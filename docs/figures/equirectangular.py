"""The directions that an equirectangular image looks along."""

import matplotlib.pyplot as plt
import numpy as np

WIDTH, HEIGHT = 3840, 1920
DIRECTIONS = (
    (0.0, "back\nlon = π"),
    (0.25, "left, +y\nlon = π/2"),
    (0.5, "forward, +x\nlon = 0"),
    (0.75, "right, -y\nlon = -π/2"),
    (1.0, "back\nlon = -π"),
)

figure, axes = plt.subplots(figsize=(8, 4.4), layout="constrained")
axes.axhline((HEIGHT - 1) / 2, color="0.8")
for column in np.arange(1, 4) * WIDTH / 4 - 0.5:
    axes.axvline(column, color="0.8")
middle = (HEIGHT - 1) / 2
for fraction, name in DIRECTIONS:
    side = "left" if fraction == 0 else "right" if fraction == 1 else "center"
    axes.annotate(
        name,
        (fraction * WIDTH - 0.5, middle),
        xytext={"left": (6, 0), "right": (-6, 0)}.get(side, (0, 0)),
        textcoords="offset points",
        ha=side,
        va="center",
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 2},
    )
axes.text(WIDTH / 2, 90, "zenith, +z: lat = π/2", ha="center", va="center")
axes.text(WIDTH / 2, HEIGHT - 90, "nadir, -z: lat = -π/2", ha="center", va="center")
axes.set(xlim=(-0.5, WIDTH - 0.5), ylim=(HEIGHT - 0.5, -0.5), aspect="equal")
axes.set(xlabel="u: column, pixel centres at integers", ylabel="v: row", title=f"{WIDTH} x {HEIGHT}")
plt.show()
