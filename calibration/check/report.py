"""What there is to say of a camera's turn against its stated mounting: the verdict, and each source of it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calibration import result_page as page
from calibration.check.assessment import CheckAssessment
from calibration.check.mounting import MountingCheck
from calibration.check.tilt_sources import NamedTilt
from calibration.report_figure import titled_figure, wide_axes
from calibration.shelf.gravity_lines import upright_edges
from palletloc.drawing.canvas import DEGREE, FAINT, GRID, INK, PLUS_MINUS, SERIES, add_legend
from palletloc.geometry import FloatArray
from palletloc.io.camera_spec import angles_from_transform

_VERDICTS = {
    0: "The camera sits as the recording says.",
    1: "The camera does not sit as the recording says.",
    3: "The data cannot tell.",
}
"""By exit code."""
_SHOWN_DEG = 1.5
"""How far edges lean on the figure at most, in degrees: ten times the usual tolerance."""
_OPEN_DEG = 5.0
"""A source with a larger standard deviation, in degrees, leaves that axis open."""


def check_page(assessment: CheckAssessment) -> page.ResultPage:
    """Return a check of a mounting, from `check_mounting`, as all outputs show it."""
    heading = "Is the mounting still right?"
    return page.ResultPage("palletloc calibrate check", heading, _VERDICTS, tuple(_sections(assessment)))


def _sections(assessment: CheckAssessment) -> Iterator[page.Section]:
    check, tolerance = assessment.check, float(np.degrees(assessment.tolerance))
    turns = tuple(_turns(check))
    if turns:
        yield page.KeyFigures(
            tuple((f"{value}{DEGREE}", f"{name} {PLUS_MINUS} {sigma}{DEGREE}") for name, value, sigma in turns)
        )
        yield page.Paragraph(
            "By so much the camera is turned about the forklift's axes against what recording.yaml says; after the"
            f" sign stands one standard deviation. Up to {tolerance:.2f}{DEGREE} of roll or pitch pass."
        )
    yield page.Findings(assessment.findings, "Nothing is left to do.")
    absent = [{"method": source.method, "why": source.why} for source in check.absent]
    yield page.JsonValues({"tolerance_deg": tolerance, "absent": absent})
    if not turns:
        return
    yield page.JsonValues(_values(check))
    yield page.Heading("Sources")
    yield page.Table(page.numbers("", f"turned by {DEGREE}", f"sigma {DEGREE}"), turns, page.Output.TERMINAL)
    rows = tuple(_source_row(source) for source in check.tilts)
    columns = (*page.words("source"), *page.numbers(f"roll {DEGREE}", "sigma", f"pitch {DEGREE}", "sigma", "sights"))
    yield page.Table(columns, rows, page.Output.TERMINAL)
    columns = (
        *page.words("source"),
        *page.numbers(f"roll {DEGREE}", f"sigma {DEGREE}", f"pitch {DEGREE}", f"sigma {DEGREE}", "sights"),
    )
    yield page.Table(columns, (*rows, *((source.method, "", "", "", "", "0") for source in check.absent)))
    yield page.Paragraph(_agreement(check), page.Output.PAGE | page.Output.TERMINAL)
    if check.yaws:
        yield page.Table(
            (*page.words("yaw by"), *page.numbers(f"yaw {DEGREE}", f"sigma {DEGREE}")),
            tuple((yaw.method, f"{np.degrees(yaw.turn):+.2f}", f"{np.degrees(yaw.sigma):.2f}") for yaw in check.yaws),
        )
    yield page.Drawing(partial(_figure, check), "How upright edges lean, by the direction in which they are seen.")


def _values(check: MountingCheck) -> dict[str, Any]:
    """Return plain values for JSON: degrees where the names say so."""
    turned, sigma = (
        dict(zip(("roll", "pitch"), np.degrees(angles).tolist(), strict=True))
        for angles in (np.zeros(2) if check.turn is None else check.turn, check.sigma)
    )
    if check.yaw is not None:
        turned["yaw"], sigma["yaw"] = (float(np.degrees(value)) for value in check.yaw)
    values: dict[str, Any] = {"turned_deg": turned, "sigma_deg": sigma, "chance": check.chance}
    values["methods"] = [
        {
            "method": source.method,
            "roll_deg": float(-np.degrees(source.tilt.turn[0])),
            "pitch_deg": float(-np.degrees(source.tilt.turn[1])),
            "sigma_deg": [value if value < _OPEN_DEG else None for value in _source_sigma(source)],
            "information_per_rad2": source.tilt.information.tolist(),
            "segments": source.tilt.segments,
        }
        for source in check.tilts
    ]
    values["yaw_methods"] = [
        {"method": yaw.method, "yaw_deg": float(np.degrees(yaw.turn)), "sigma_deg": float(np.degrees(yaw.sigma))}
        for yaw in check.yaws
    ]
    if check.height is not None:
        values["height_mm"], values["height_sigma_mm"] = (1000 * value for value in check.height)
    values["better_roll_pitch_yaw_deg"] = list(angles_from_transform(check.corrected())[1])
    return values


def _turns(check: MountingCheck) -> list[tuple[str, str, str]]:
    """Return name, angle and standard deviation of each turn, in degrees, as texts."""
    if check.turn is None:
        return []
    rows = [
        (name, f"{np.degrees(value):+.3f}", f"{np.degrees(sigma):.3f}")
        for name, value, sigma in zip(("roll", "pitch"), check.turn, check.sigma, strict=True)
    ]
    if check.yaw is not None:
        rows.append(("yaw", f"{np.degrees(check.yaw[0]):+.2f}", f"{np.degrees(check.yaw[1]):.2f}"))
    return rows


def _agreement(check: MountingCheck) -> str:
    """Say whether the sources agree, and what they say of the height."""
    parts = [f"Chance leaves differences like these, or larger ones, to {100 * check.chance:.2g} % of cases."]
    if check.worst is not None:
        parts.append(f"{check.worst.first} and {check.worst.second} differ most.".capitalize())
    if check.height is not None:
        height, sigma = (1000 * value for value in check.height)
        parts.append(f"The camera is {height:+.0f} {PLUS_MINUS} {sigma:.0f} mm higher than stated, by the pallets.")
    return " ".join(parts)


def _source_row(source: NamedTilt) -> tuple[str, ...]:
    """Return the cells of a source; an axis that it leaves open stays empty."""
    cells = [source.method]
    for value, sigma in zip(source.tilt.turn, _source_sigma(source), strict=True):
        cells += [f"{-np.degrees(value):+.3f}", f"{sigma:.3f}"] if sigma < _OPEN_DEG else ["", ""]
    return (*cells, str(source.tilt.segments))


def _source_sigma(source: NamedTilt) -> list[float]:
    """Return the standard deviations of roll and pitch by one source, in degrees; an axis left open has about 57."""
    covariance = np.linalg.inv(source.tilt.information + np.eye(2))
    return [float(value) for value in np.degrees(np.sqrt(np.diag(covariance)))]


def _figure(check: MountingCheck) -> Figure:
    line = "A wave means that the camera is turned; a straight line at zero that it is not"
    figure = titled_figure(470, "How upright edges lean", line)
    axes = wide_axes(figure, 310)
    azimuth, away, sigma, _ = upright_edges(check.segments)
    near = sigma < 3 * np.median(sigma)
    axes.plot(np.degrees(azimuth[near]), np.degrees(away[near]), ".", color=FAINT, markersize=4, label="edge")
    around = np.linspace(-np.pi, np.pi, 181)
    axes.plot(np.degrees(around), _wave(check, around), color=SERIES[1], label="found")
    axes.axhline(0.0, color=INK, linewidth=0.8, label="as stated")
    axes.set(
        xlim=(-180, 180),
        ylim=(-_SHOWN_DEG, _SHOWN_DEG),
        xlabel=f"azimuth in the forklift frame ({DEGREE}), left is +",
        ylabel=f"leans by ({DEGREE})",
    )
    axes.grid(color=GRID, linewidth=0.6)
    add_legend(figure, 440, axes)
    return figure


def _wave(check: MountingCheck, azimuth: FloatArray) -> FloatArray:
    turn = np.zeros(2) if check.turn is None else -check.turn
    return np.asarray(np.degrees(np.cos(azimuth) * turn[0] + np.sin(azimuth) * turn[1]))
