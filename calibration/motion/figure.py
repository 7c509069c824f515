"""The picture of a drive past targets: its way, what is left of the bearings, and where the odometry jumps."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.drive import compose
from calibration.motion.fit import MotionFit
from palletloc.drawing.canvas import FAINT, GRID, INK, SERIES, WIDTH_PX, add_axes, add_legend, add_text, new_figure
from palletloc.geometry import FloatArray

_LEFT, _RIGHT, _HEAD = 74, 24, 72
_SIGMAS = 3.0


def motion_figure(fit: MotionFit) -> Figure:
    """Draw a fitted drive.

    Parameters
    ----------
    fit : MotionFit
        The drive.
    """
    figure = new_figure(980)
    add_text(figure, _LEFT, 14, "The drive from above, and what is left in each shot", size=13, bold=True)
    add_text(
        figure, _LEFT, 40, "Below: bearings and the odometry's increments against the fit, in standard deviations"
    )
    wide = WIDTH_PX - _LEFT - _RIGHT
    plan = add_axes(figure, _LEFT, _HEAD, wide, 400)
    sights = add_axes(figure, _LEFT, _HEAD + 445, wide, 170)
    steps = add_axes(figure, _LEFT, _HEAD + 660, wide, 170)
    _draw_way(plan, fit)
    _draw_sights(sights, fit)
    _draw_steps(steps, fit)
    add_legend(figure, 945, plan, sights, steps, columns=6)
    return figure


def shot_rms(fit: MotionFit) -> FloatArray:
    """Return the rms of the bearings' residuals of each shot, (n,), in standard deviations; NaN without any."""
    network = fit.network
    off = network.residuals(fit.state)[: network.image_rows].reshape(-1, 2)
    square = np.bincount(network.rows.shot, (off**2).sum(axis=1) / 2, len(network.times))
    count = np.bincount(network.rows.shot, minlength=len(network.times))
    return np.asarray(np.sqrt(np.where(count > 0, square / np.maximum(count, 1), np.nan)))


def _draw_way(axes: Axes, fit: MotionFit) -> None:
    state = fit.state
    camera = np.array([*state.camera.translation[:2], 0.0])
    eyes = compose(state.poses, np.tile(camera, (len(state.poses), 1)))
    axes.plot(state.poses[:, 0], state.poses[:, 1], "-o", color=FAINT, markersize=3, linewidth=1, label="forklift")
    axes.plot(eyes[:, 0], eyes[:, 1], "o", color=SERIES[0], markersize=4, label="camera at the shots")
    axes.plot(state.boards[:, 0, 3], state.boards[:, 1, 3], "s", color=SERIES[1], markersize=8, label="target")
    seen = {(int(shot), sight.target) for shot, sight in zip(fit.network.shot_of, fit.network.sights, strict=True)}
    for shot, target in seen:
        x, y = zip(eyes[shot, :2], state.boards[target, :2, 3], strict=True)
        axes.plot(x, y, color=GRID, linewidth=0.7, zorder=0)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x of odom (m)", ylabel="y of odom (m)")
    axes.grid(color=GRID, linewidth=0.6)


def _draw_sights(axes: Axes, fit: MotionFit) -> None:
    axes.bar(fit.network.times, shot_rms(fit), 0.1, color=SERIES[0], label="bearings, rms")
    axes.axhline(1.0, color=INK, linewidth=0.8)
    axes.set(ylabel="bearings (sigma)")
    axes.grid(color=GRID, linewidth=0.6)


def _draw_steps(axes: Axes, fit: MotionFit) -> None:
    middles = (fit.network.times[1:] + fit.network.times[:-1]) / 2
    slips = fit.network.slips(fit.state) * fit.network.drive_scale
    for column, name, color in zip(slips.T, ("along", "across", "turn"), SERIES[1:4], strict=True):
        axes.plot(middles, column, "-o", color=color, markersize=3, linewidth=1, label=f"step {name}")
    for bound in (-_SIGMAS, _SIGMAS):
        axes.axhline(bound, color=INK, linewidth=0.8, linestyle="--")
    axes.set(xlabel="time (s)", ylabel="odometry (sigma)")
    axes.grid(color=GRID, linewidth=0.6)
