"""What there is to say of a drive past targets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration import result_page as page
from calibration.degeneracy import LIMITS, NAMES, in_words
from calibration.drive import compose
from calibration.motion.assessment import MotionResult
from calibration.motion.fit import MotionFit
from calibration.report_figure import HEAD, titled_figure, wide_axes
from calibration.rig_file import rig_text
from palletloc.drawing.canvas import DEGREE, FAINT, GRID, INK, SERIES, add_legend
from palletloc.geometry import FloatArray
from palletloc.io.camera_spec import spec_from_camera

_VERDICTS = {
    0: "The drive confirms the mounting.",
    1: "The drive contradicts the mounting, or tells too little.",
    3: "The drive tells only a part of the mounting.",
}
"""By exit code."""
_SIGMAS = 3.0
"""Lines in the figure of the odometry's steps, in standard deviations."""


def motion_page(result: MotionResult) -> page.ResultPage:
    """Return what a drive tells, from `calibrate_motion`, as all outputs show it."""
    content = None if result.mounting is None else rig_text(spec_from_camera(result.camera), result.mounting)
    heading = "What the drive tells about the mounting"
    return page.ResultPage(
        "palletloc calibrate extrinsics --motion", heading, _VERDICTS, tuple(_sections(result)), content
    )


def _sections(result: MotionResult) -> Iterator[page.Section]:
    yield page.Findings(result.findings, "Nothing is left to do.")
    fit, away = result.assessment.fit, result.assessment.away
    if fit is None or away is None:
        return
    yield from _directions(fit)
    yield from _mounting(fit, away)
    yield page.Heading("Directions")
    yield page.Table((*page.words("", "direction"), *page.numbers("sigma")), _direction_rows(fit))
    yield page.Drawing(partial(_figure, fit), "The way, and what is left after the fit.")
    yield from _odometry(fit)


def _directions(fit: MotionFit) -> Iterator[page.Section]:
    known, lost = fit.split()
    for name, part in (("lost_directions", lost), ("known_directions", known)):
        yield page.JsonValues({name: [in_words(direction) for direction in part.T]})


def _mounting(fit: MotionFit, away: FloatArray) -> Iterator[page.Section]:
    told = fit.sigma <= LIMITS
    yield page.JsonValues({"order": list(NAMES)})
    for key, values in (("found_minus_stated", away), ("sigma", fit.sigma)):
        yield page.JsonValues({key: [float(v) if known else None for v, known in zip(values, told, strict=True)]})
    rows = []
    for i, name in enumerate(NAMES):
        factor, unit = (1000.0, " mm") if i < 3 else (float(np.degrees(1.0)), DEGREE)
        found = (f"{factor * away[i]:+.2f}{unit}", f"{factor * fit.sigma[i]:.2f}{unit}")
        rows.append((name, *(found if told[i] else ("not told", ""))))
    yield page.Heading("Mounting")
    yield from _table(("", "found minus stated", "sigma"), rows)


def _table(terminal: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> Iterator[page.Section]:
    """Yield a table for the page, and the same for the terminal, where its first column stands at the right."""
    yield page.Table((*page.words(""), *page.numbers(*terminal[1:])), tuple(rows))
    yield page.Table(page.numbers(*terminal), tuple(rows), page.Output.TERMINAL)


def _direction_rows(fit: MotionFit) -> tuple[tuple[str, ...], ...]:
    """Return what the drive tells and what it loses: the sense, the direction in words, its sigma."""
    rows = []
    covariance = fit.covariance / np.outer(LIMITS, LIMITS)
    for name, part in zip(("told", "lost"), fit.split(), strict=True):
        for i in range(part.shape[1]):
            moved = part[:, i] * LIMITS
            sigma = float(np.sqrt(part[:, i] @ covariance @ part[:, i]))
            place, turn = 1000 * sigma * np.linalg.norm(moved[:3]), np.degrees(sigma * np.linalg.norm(moved[3:]))
            text = f"{place:.1f} mm with {turn:.2f}{DEGREE}" if name == "told" else "not told"
            rows.append((name, in_words(part[:, i]), text))
    return tuple(rows)


def _odometry(fit: MotionFit) -> Iterator[page.Section]:
    state = fit.state
    values, sigmas = (state.scale, state.bias, state.delay), [float(sigma) for sigma in fit.fault_sigma]
    names = ("wheel_scale", "yaw_rate_bias_radps", "time_offset_s")
    pairs = zip(names, values, sigmas, strict=True)
    yield page.JsonValues({"odometry": {name: {"value": value, "sigma": sigma} for name, value, sigma in pairs}})
    problem = fit.problem
    yield page.JsonValues({"sight_factor": problem.bearing_scale, "odometry_factor": problem.drive_scale})
    yield page.Heading("Odometry")
    scale, bias, delay = sigmas
    rows = [
        ("wheel scale", f"{state.scale:.4f}", f"{scale:.4f}"),
        ("yaw rate's bias deg/s", f"{np.degrees(state.bias):+.3f}", f"{np.degrees(bias):.3f}"),
        ("time offset ms", f"{1000 * state.delay:+.0f}", f"{1000 * delay:.0f}"),
    ]
    yield from _table(("odometry", "value", "sigma"), rows)


def _figure(fit: MotionFit) -> Figure:
    """Draw the way, what is left of the bearings, and where the odometry jumps."""
    line = "Below: bearings and the odometry's increments against the fit, in standard deviations"
    figure = titled_figure(980, "The drive from above, and what is left in each shot", line)
    plan, bearings, steps = (wide_axes(figure, high, HEAD + top) for high, top in ((400, 0), (170, 445), (170, 660)))
    _draw_way(plan, fit)
    _draw_bearings(bearings, fit)
    _draw_steps(steps, fit)
    add_legend(figure, 945, plan, bearings, steps, columns=6)
    return figure


def _shot_rms(fit: MotionFit) -> FloatArray:
    """Return the rms of the bearings' residuals of each shot, (n,), in standard deviations; NaN without any."""
    problem = fit.problem
    off = problem.residuals(fit.state)[: problem.image_rows].reshape(-1, 2)
    square = np.bincount(problem.rows.shot, (off**2).sum(axis=1) / 2, len(problem.times))
    count = np.bincount(problem.rows.shot, minlength=len(problem.times))
    return np.asarray(np.sqrt(np.where(count > 0, square / np.maximum(count, 1), np.nan)))


def _draw_way(axes: Axes, fit: MotionFit) -> None:
    state = fit.state
    camera = np.array([*state.camera.translation[:2], 0.0])
    eyes = compose(state.poses, np.tile(camera, (len(state.poses), 1)))
    axes.plot(state.poses[:, 0], state.poses[:, 1], "-o", color=FAINT, markersize=3, linewidth=1, label="forklift")
    axes.plot(eyes[:, 0], eyes[:, 1], "o", color=SERIES[0], markersize=4, label="camera at the shots")
    axes.plot(state.boards[:, 0, 3], state.boards[:, 1, 3], "s", color=SERIES[1], markersize=8, label="target")
    seen = {
        (int(shot), corners.target)
        for shot, corners in zip(fit.problem.shot_of, fit.problem.observations, strict=True)
    }
    for shot, target in seen:
        x, y = zip(eyes[shot, :2], state.boards[target, :2, 3], strict=True)
        axes.plot(x, y, color=GRID, linewidth=0.7, zorder=0)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x of odom (m)", ylabel="y of odom (m)")
    axes.grid(color=GRID, linewidth=0.6)


def _draw_bearings(axes: Axes, fit: MotionFit) -> None:
    axes.bar(fit.problem.times, _shot_rms(fit), 0.1, color=SERIES[0], label="bearings, rms")
    axes.axhline(1.0, color=INK, linewidth=0.8)
    axes.set(ylabel="bearings (sigma)")
    axes.grid(color=GRID, linewidth=0.6)


def _draw_steps(axes: Axes, fit: MotionFit) -> None:
    middles = (fit.problem.times[1:] + fit.problem.times[:-1]) / 2
    slips = fit.problem.slips(fit.state) * fit.problem.drive_scale
    for column, name, color in zip(slips.T, ("along", "across", "turn"), SERIES[1:4], strict=True):
        axes.plot(middles, column, "-o", color=color, markersize=3, linewidth=1, label=f"step {name}")
    for bound in (-_SIGMAS, _SIGMAS):
        axes.axhline(bound, color=INK, linewidth=0.8, linestyle="--")
    axes.set(xlabel="time (s)", ylabel="odometry (sigma)")
    axes.grid(color=GRID, linewidth=0.6)
