"""The figures of fitted lenses: coverage, residuals, how well bearings are known, correlations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from calibration.intrinsics.assessment import SECTORS, Checked, Coverage
from calibration.lenses.fit import LensFit
from calibration.report_figure import HEAD, draw_correlations, titled_figure, wide_axes
from palletloc.drawing.canvas import DEGREE, FAINT, GRID, INK, SERIES, WIDTH_PX, add_axes, add_legend

_LEFT = 84
"""Margin of the axes, in pixels of the figure: rows have up to four digits."""
_SIDE, _HALF_SIDE, _HALF_TOP = 420, 540, 84
"""Of square axes: their side, that of the halves of a stitched image, and where these begin, in pixels."""


def coverage_figure(coverage: Sequence[Coverage]) -> Figure:
    """Draw where corners are: angle off axis outwards, around the axis as in the image."""
    figure = titled_figure(
        560, "Coverage", f"Angle off axis ({DEGREE}) from the middle outwards; grey: sectors without a corner", _LEFT
    )
    for lens, cover in enumerate(coverage):
        left = _LEFT + lens * (_SIDE + 120)
        axes = add_axes(figure, left, HEAD + 10, _SIDE, _SIDE)
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
    figure = titled_figure(400, "How well bearings are known", line, _LEFT)
    axes = wide_axes(figure, 250, left=_LEFT)
    for lens, (angle, sigma) in enumerate(zip(checked.angles, checked.bearing_sigma, strict=True)):
        axes.plot(np.degrees(angle), np.degrees(sigma), color=SERIES[lens], label=f"lens {lens}")
    axes.set(xlabel=f"angle off axis ({DEGREE})", ylabel=f"sigma ({DEGREE})")
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
    figure = titled_figure(760, "Residuals in the image", line, _LEFT)
    axes = wide_axes(figure, 620, left=_LEFT)
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
    figure = titled_figure(400, "Residuals by angle", line, _LEFT)
    axes = wide_axes(figure, 250, left=_LEFT)
    for lens, cover in enumerate(checked.coverage):
        mine = [i for i, view in enumerate(fit.problem.views) if view.lens == lens]
        residuals = np.concatenate([fit.residuals[i][fit.used[i]] for i in mine])
        away = residuals[:, 0] * np.cos(cover.azimuth) + residuals[:, 1] * np.sin(cover.azimuth)
        axes.plot(np.degrees(cover.angle), away, ".", color=SERIES[lens], markersize=3, label=f"lens {lens}")
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set(xlabel=f"angle off axis ({DEGREE})", ylabel="outwards (px)")
    axes.grid(color=GRID, linewidth=0.6)
    add_legend(figure, 372, axes)
    return figure


def correlation_figure(fit: LensFit) -> Figure:
    """Draw the correlations of the parameters."""
    line = "Near 1 or -1 two numbers cannot be told apart; bearings are not worse for it"
    figure = titled_figure(560, "Correlations", line, _LEFT)
    draw_correlations(wide_axes(figure, 440, left=_LEFT), fit.correlation, fit.problem.names(), 9)
    return figure


def halves_figure(fit: LensFit, name: str) -> Figure:
    """Draw the residuals in both halves of the image, each around its lens's axis."""
    used = [part[keep] for part, keep in zip(fit.residuals, fit.used, strict=True)]
    largest = max((float(np.linalg.norm(part, axis=-1).max()) for part in used if len(part)), default=1e-9)
    factor = 60.0 / max(largest, 1e-9)
    line = f"Around each lens's axis, in pixels of the image; drawn {factor:.0f} times as long; crosses were left out"
    figure = titled_figure(_HALF_SIDE + 150, f"Residuals {name}: {fit.rms():.3f} px", line, _LEFT)
    limit = 1.08 * float(fit.rig.values[0][0]) * np.pi / 2
    for lens, title in enumerate(("front", "back")):
        axes = add_axes(figure, _LEFT + lens * (WIDTH_PX - 110) / 2, _HALF_TOP, _HALF_SIDE, _HALF_SIDE)
        axes.set(xlim=(-limit, limit), ylim=(limit, -limit), xlabel=f"{title} lens (px)")
        axes.grid(color=GRID, linewidth=0.6)
        for view, keep, part in zip(fit.problem.views, fit.used, fit.residuals, strict=True):
            if view.lens == lens:
                axes.quiver(
                    *view.pixels[keep].T, *(factor * part[keep].T), color=SERIES[lens], angles="xy",
                    scale_units="xy", scale=1, width=0.002, headwidth=4,
                )  # fmt: skip
                axes.plot(*view.pixels[~keep].T, "x", color=FAINT, markersize=5)
    return figure
