"""The figures of a lens report: coverage, residuals, how well bearings are known, correlations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from calibration.intrinsics.assessment import SECTORS, Checked, Coverage
from calibration.lenses.fit import LensFit
from palletloc.drawing.canvas import FAINT, GRID, INK, SERIES, WIDTH_PX, add_axes, add_legend, add_text, new_figure

_LEFT, _RIGHT, _HEAD = 84, 24, 72
_SIDE = 420
_DEGREE = "\N{DEGREE SIGN}"


def _titled(height: float, title: str, line: str) -> Figure:
    figure = new_figure(height)
    add_text(figure, _LEFT, 14, title, size=13, bold=True)
    add_text(figure, _LEFT, 40, line, size=10.5)
    return figure


def coverage_figure(coverage: Sequence[Coverage]) -> Figure:
    """Draw where corners are: angle off axis outwards, around the axis as in the image."""
    figure = _titled(
        560, "Coverage", f"Angle off axis ({_DEGREE}) from the middle outwards; grey: sectors without a corner"
    )
    for lens, cover in enumerate(coverage):
        left = _LEFT + lens * (_SIDE + 120)
        axes = add_axes(figure, left, _HEAD + 10, _SIDE, _SIDE)
        limit = 1.05 * np.degrees(cover.max_angle)
        axes.set(xlim=(-limit, limit), ylim=(limit, -limit))
        axes.set_aspect("equal")
        rings = np.degrees(cover.max_angle) * np.arange(len(cover.filled) + 1) / len(cover.filled)
        for (ring, sector), filled in np.ndenumerate(cover.filled):
            if not filled:
                turn = 2 * np.pi * (sector + np.linspace(0, 1, 9)) / SECTORS
                edge = np.concatenate([rings[ring] * np.exp(1j * turn), rings[ring + 1] * np.exp(1j * turn[::-1])])
                axes.fill(edge.real, edge.imag, color=GRID)
        away = np.degrees(cover.angle)
        axes.plot(away * np.cos(cover.azimuth), away * np.sin(cover.azimuth), ".", color=SERIES[lens], markersize=3)
        axes.set_xlabel(f"lens {lens}: {100 * cover.filled.mean():.0f} % of the sectors filled")
    return figure


def uncertainty_figure(checked: Checked) -> Figure:
    """Draw the standard deviation of bearings over the angle off axis."""
    line = "From the covariance of all parameters; a common rotation left out, which belongs to the mounting"
    figure = _titled(400, "How well bearings are known", line)
    axes = add_axes(figure, _LEFT, _HEAD, WIDTH_PX - _LEFT - _RIGHT, 250)
    for lens, (angle, sigma) in enumerate(zip(checked.angles, checked.bearing_sigma, strict=True)):
        axes.plot(np.degrees(angle), np.degrees(sigma), color=SERIES[lens], label=f"lens {lens}")
    axes.set(xlabel=f"angle off axis ({_DEGREE})", ylabel=f"sigma ({_DEGREE})")
    axes.set_ylim(bottom=0)
    axes.grid(color=GRID, linewidth=0.6)
    add_legend(figure, 372, axes)
    return figure


def residual_figure(fit: LensFit) -> Figure:
    """Draw all residuals where they are in the image."""
    pixels = np.concatenate([view.pixels for view in fit.problem.views])
    residuals, used = np.concatenate(fit.residuals), np.concatenate(fit.used)
    extent = float(np.ptp(pixels, axis=0).max())
    factor = 0.04 * extent / max(float(np.linalg.norm(residuals[used], axis=-1).max(initial=0.0)), 1e-9)
    line = f"Fitted minus seen, {factor:.0f} times as long; crosses: left out. Where arrows agree, the model misfits"
    figure = _titled(760, "Residuals in the image", line)
    axes = add_axes(figure, _LEFT, _HEAD, WIDTH_PX - _LEFT - _RIGHT, 620)
    axes.quiver(
        *pixels[used].T, *(factor * residuals[used].T), color=SERIES[0], angles="xy", scale_units="xy", scale=1,
        width=0.0012, headwidth=4,
    )  # fmt: skip
    axes.plot(*pixels[~used].T, "x", color=FAINT, markersize=5)
    axes.set_aspect("equal", adjustable="datalim")
    axes.invert_yaxis()
    axes.set(xlabel="column (px)", ylabel="row (px)")
    axes.grid(color=GRID, linewidth=0.6)
    return figure


def radial_figure(fit: LensFit, checked: Checked) -> Figure:
    """Draw the residuals away from the axis over the angle off it."""
    line = "Part of each residual away from the axis; a bend is the model, not noise"
    figure = _titled(400, "Residuals by angle", line)
    axes = add_axes(figure, _LEFT, _HEAD, WIDTH_PX - _LEFT - _RIGHT, 250)
    for lens, cover in enumerate(checked.coverage):
        mine = [i for i, view in enumerate(fit.problem.views) if view.lens == lens]
        residuals = np.concatenate([fit.residuals[i][fit.used[i]] for i in mine])
        away = residuals[:, 0] * np.cos(cover.azimuth) + residuals[:, 1] * np.sin(cover.azimuth)
        axes.plot(np.degrees(cover.angle), away, ".", color=SERIES[lens], markersize=3, label=f"lens {lens}")
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set(xlabel=f"angle off axis ({_DEGREE})", ylabel="outwards (px)")
    axes.grid(color=GRID, linewidth=0.6)
    add_legend(figure, 372, axes)
    return figure


def matrix_figure(fit: LensFit) -> Figure:
    """Draw the correlations of the parameters."""
    line = "Near 1 or -1 two numbers cannot be told apart; bearings are not worse for it"
    figure = _titled(560, "Correlations", line)
    axes = add_axes(figure, _LEFT, _HEAD, WIDTH_PX - _LEFT - _RIGHT, 440)
    names = fit.problem.names()
    axes.imshow(fit.correlation, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    axes.set_xticks(range(len(names)), names, rotation=0 if len(names) < 13 else 90)
    axes.set_yticks(range(len(names)), names)
    for (row, column), value in np.ndenumerate(fit.correlation):
        if len(names) < 13:
            color = "white" if abs(value) > 0.6 else INK
            axes.text(column, row, f"{round(value, 2) + 0.0:.2f}", ha="center", va="center", size=9, color=color)
    return figure
