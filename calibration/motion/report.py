"""The report of a drive past targets: one page of HTML that needs nothing but itself, and the same as JSON."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from calibration.degeneracy import LIMITS, NAMES, in_words
from calibration.finding_table import finding_data, finding_parts
from calibration.motion.assessment import MotionAssessment
from calibration.motion.figure import motion_figure
from calibration.motion.fit import MotionFit
from palletloc.drawing.canvas import small_png
from palletloc.report.page import Column, embedded, heading, page, paragraph, picture, table

_VERDICT = {
    0: "The drive confirms the mounting.",
    1: "The drive contradicts the mounting, or tells too little.",
    3: "The drive tells only a part of the mounting.",
}


def motion_rows(assessment: MotionAssessment) -> list[list[str]]:
    """Return name, found minus stated, and standard deviation of the six numbers, as texts."""
    fit, away = assessment.fit, assessment.away
    if fit is None or away is None:
        return []
    rows = []
    for i, name in enumerate(NAMES):
        factor, unit = (1000.0, " mm") if i < 3 else (float(np.degrees(1.0)), "\N{DEGREE SIGN}")
        known = fit.sigma[i] <= LIMITS[i]
        cells = (
            [f"{factor * away[i]:+.2f}{unit}", f"{factor * fit.sigma[i]:.2f}{unit}"] if known else ["not told", ""]
        )
        rows.append([name, *cells])
    return rows


def fault_rows(assessment: MotionAssessment) -> list[list[str]]:
    """Return name, value and standard deviation of the odometry's faults, as texts."""
    fit = assessment.fit
    if fit is None:
        return []
    scale, bias, delay = fit.fault_sigma
    state = fit.state
    return [
        ["wheel scale", f"{state.scale:.4f}", f"{scale:.4f}"],
        ["yaw rate's bias deg/s", f"{np.degrees(state.bias):+.3f}", f"{np.degrees(bias):.3f}"],
        ["time offset ms", f"{1000 * state.delay:+.0f}", f"{1000 * delay:.0f}"],
    ]


def direction_rows(fit: MotionFit) -> list[list[str]]:
    """Return what the drive tells and what it loses, as texts: the sense, the direction in words, its sigma."""
    rows = []
    covariance = fit.covariance / np.outer(LIMITS, LIMITS)
    for name, part in zip(("told", "lost"), fit.split(), strict=True):
        for i in range(part.shape[1]):
            moved = part[:, i] * LIMITS
            sigma = float(np.sqrt(part[:, i] @ covariance @ part[:, i]))
            place, turn = 1000 * sigma * np.linalg.norm(moved[:3]), np.degrees(sigma * np.linalg.norm(moved[3:]))
            text = f"{place:.1f} mm with {turn:.2f}\N{DEGREE SIGN}" if name == "told" else "not told"
            rows.append([name, in_words(part[:, i]), text])
    return rows


def motion_data(assessment: MotionAssessment) -> dict[str, Any]:
    """Return the report as plain values for JSON; None for what the drive does not tell."""
    data: dict[str, Any] = {
        "format": 1,
        "exit_code": assessment.exit_code,
        "reasons": [finding_data(one) for one in assessment.findings],
    }
    fit, away = assessment.fit, assessment.away
    if fit is None or away is None:
        return data
    known, lost = fit.split()
    data["lost_directions"] = [in_words(lost[:, i]) for i in range(lost.shape[1])]
    data["known_directions"] = [in_words(known[:, i]) for i in range(known.shape[1])]
    told = fit.sigma <= LIMITS
    data["order"] = list(NAMES)
    data["found_minus_stated"] = [float(v) if t else None for v, t in zip(away, told, strict=True)]
    data["sigma"] = [float(v) if t else None for v, t in zip(fit.sigma, told, strict=True)]
    names = ("wheel_scale", "yaw_rate_bias_radps", "time_offset_s")
    values = (fit.state.scale, fit.state.bias, fit.state.delay)
    data["odometry"] = {
        name: {"value": value, "sigma": float(sigma)}
        for name, value, sigma in zip(names, values, fit.fault_sigma, strict=True)
    }
    data["sight_factor"], data["odometry_factor"] = fit.network.sight_scale, fit.network.drive_scale
    return data


def motion_page(assessment: MotionAssessment) -> str:
    """Return the report as a page of HTML."""
    return page("palletloc calibrate extrinsics --motion", _parts(assessment))


def _parts(assessment: MotionAssessment) -> Iterator[str]:
    yield heading("What the drive tells about the mounting", level=1)
    yield paragraph(_VERDICT[assessment.exit_code], "lead")
    yield from finding_parts(assessment.findings, "Nothing is left to do.")
    if assessment.fit is None:
        return
    yield heading("Mounting")
    first = Column("", is_text=True)
    yield table((first, Column("found minus stated"), Column("sigma")), motion_rows(assessment))
    yield heading("Directions")
    yield table((first, Column("direction", is_text=True), Column("sigma")), direction_rows(assessment.fit))
    yield picture(
        embedded(small_png(motion_figure(assessment.fit))), "The way, and what is left after the fit.", keep_wide=True
    )
    yield heading("Odometry")
    yield table((first, Column("value"), Column("sigma")), fault_rows(assessment))
