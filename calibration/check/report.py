"""The report of a check: one page of HTML that needs nothing but itself, and the same as JSON."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calibration.check.assessment import CheckAssessment
from calibration.check.mounting import MountingCheck
from calibration.check.tilt_sources import NamedTilt
from calibration.finding_table import finding_data, finding_parts
from calibration.shelf.gravity_lines import upright_edges
from palletloc.drawing.canvas import (
    FAINT,
    GRID,
    INK,
    SERIES,
    WIDTH_PX,
    add_axes,
    add_legend,
    add_text,
    new_figure,
    small_png,
)
from palletloc.geometry import FloatArray
from palletloc.io.camera_spec import angles_from_transform
from palletloc.report.page import Column, embedded, heading, key_figures, page, paragraph, picture, table

_DEGREE, _PM = "\N{DEGREE SIGN}", "\N{PLUS-MINUS SIGN}"
_VERDICT = {
    0: "The camera sits as the recording says.",
    1: "The camera does not sit as the recording says.",
    3: "The data cannot tell.",
}
_LEFT, _RIGHT, _HEAD = 74, 24, 72
_SHOWN_DEG = 1.5
_OPEN_DEG = 5.0


def check_data(assessment: CheckAssessment) -> dict[str, Any]:
    """Return the report as plain values for JSON: degrees where the names say so."""
    check = assessment.check
    data: dict[str, Any] = {
        "format": 1,
        "exit_code": assessment.exit_code,
        "reasons": [finding_data(finding) for finding in assessment.findings],
        "tolerance_deg": float(np.degrees(assessment.tolerance)),
    }
    data["absent"] = [{"method": source.method, "why": source.why} for source in check.absent]
    if check.turn is None:
        return data
    data["turned_deg"] = dict(zip(("roll", "pitch"), np.degrees(check.turn).tolist(), strict=True))
    data["sigma_deg"] = dict(zip(("roll", "pitch"), np.degrees(check.sigma).tolist(), strict=True))
    data["chance"] = check.chance
    if check.yaw is not None:
        data["turned_deg"]["yaw"], data["sigma_deg"]["yaw"] = (float(np.degrees(value)) for value in check.yaw)
    data["methods"] = [
        {
            "method": source.method,
            "roll_deg": float(-np.degrees(source.tilt.turn[0])),
            "pitch_deg": float(-np.degrees(source.tilt.turn[1])),
            "sigma_deg": [value if value < _OPEN_DEG else None for value in source_sigma(source)],
            "information_per_rad2": source.tilt.information.tolist(),
            "segments": source.tilt.segments,
        }
        for source in check.tilts
    ]
    data["yaw_methods"] = [
        {
            "method": source.method,
            "yaw_deg": float(np.degrees(source.turn)),
            "sigma_deg": float(np.degrees(source.sigma)),
        }
        for source in check.yaws
    ]
    if check.height is not None:
        data["height_mm"], data["height_sigma_mm"] = (1000 * value for value in check.height)
    data["better_roll_pitch_yaw_deg"] = list(angles_from_transform(check.corrected())[1])
    return data


def check_page(assessment: CheckAssessment) -> str:
    """Return the report as a page of HTML."""
    return page("palletloc calibrate check", _parts(assessment))


def _parts(assessment: CheckAssessment) -> Iterator[str]:
    check = assessment.check
    yield heading("Is the mounting still right?", level=1)
    yield paragraph(_VERDICT[assessment.exit_code], "lead")
    if check.turn is not None:
        yield key_figures([(f"{value}{_DEGREE}", f"{name} {_PM} {s}{_DEGREE}") for name, value, s in turns(check)])
        yield paragraph(
            "By so much the camera is turned about the forklift's axes against what recording.yaml says; after the"
            f" sign stands one standard deviation. Up to {np.degrees(assessment.tolerance):.2f}{_DEGREE} of roll or"
            " pitch pass."
        )
    yield from finding_parts(assessment.findings, "Nothing is left to do.")
    if check.turn is None:
        return
    yield heading("Sources")
    columns = ("roll", "sigma", "pitch", "sigma")
    yield table(
        (Column("source", is_text=True), *(Column(f"{name} {_DEGREE}") for name in columns), Column("sights")),
        [source_row(source) for source in check.tilts]
        + [[source.method, "", "", "", "", "0"] for source in check.absent],
    )
    yield paragraph(agreement(check))
    if check.yaws:
        yield table(
            (Column("yaw by", is_text=True), Column(f"yaw {_DEGREE}"), Column(f"sigma {_DEGREE}")),
            [
                [source.method, f"{np.degrees(source.turn):+.2f}", f"{np.degrees(source.sigma):.2f}"]
                for source in check.yaws
            ],
        )
    yield picture(
        embedded(small_png(_figure(check))), "How upright edges lean, by the direction in which they are seen.",
        keep_wide=True,
    )  # fmt: skip


def turns(check: MountingCheck) -> list[tuple[str, str, str]]:
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


def agreement(check: MountingCheck) -> str:
    """Say whether the sources agree, and what they say of the height."""
    parts = [f"Chance leaves differences like these, or larger ones, to {100 * check.chance:.2g} % of cases."]
    if check.worst is not None:
        parts.append(f"{check.worst.first} and {check.worst.second} differ most.".capitalize())
    if check.height is not None:
        height, sigma = (1000 * value for value in check.height)
        parts.append(f"The camera is {height:+.0f} {_PM} {sigma:.0f} mm higher than stated, by the pallets.")
    return " ".join(parts)


def source_row(source: NamedTilt) -> list[str]:
    """Return the cells of a source; an axis that it leaves open stays empty."""
    cells = [source.method]
    for value, sigma in zip(source.tilt.turn, source_sigma(source), strict=True):
        cells += [f"{-np.degrees(value):+.3f}", f"{sigma:.3f}"] if sigma < _OPEN_DEG else ["", ""]
    return [*cells, str(source.tilt.segments)]


def source_sigma(source: NamedTilt) -> list[float]:
    """Return the standard deviations of roll and pitch by one source, in degrees; an axis left open has about 57."""
    covariance = np.linalg.inv(source.tilt.information + np.eye(2))
    return [float(value) for value in np.degrees(np.sqrt(np.diag(covariance)))]


def _figure(check: MountingCheck) -> Figure:
    figure = new_figure(470)
    add_text(figure, _LEFT, 14, "How upright edges lean", size=13, bold=True)
    add_text(figure, _LEFT, 40, "A wave means that the camera is turned; a straight line at zero that it is not")
    axes = add_axes(figure, _LEFT, _HEAD, WIDTH_PX - _LEFT - _RIGHT, 310)
    azimuth, away, sigma, _ = upright_edges(check.segments)
    near = sigma < 3 * np.median(sigma)
    axes.plot(np.degrees(azimuth[near]), np.degrees(away[near]), ".", color=FAINT, markersize=4, label="edge")
    around = np.linspace(-np.pi, np.pi, 181)
    axes.plot(np.degrees(around), _wave(check, around), color=SERIES[1], label="found")
    axes.axhline(0.0, color=INK, linewidth=0.8, label="as stated")
    axes.set(
        xlim=(-180, 180),
        ylim=(-_SHOWN_DEG, _SHOWN_DEG),
        xlabel=f"azimuth in the forklift frame ({_DEGREE}), left is +",
        ylabel=f"leans by ({_DEGREE})",
    )
    axes.grid(color=GRID, linewidth=0.6)
    add_legend(figure, 440, axes)
    return figure


def _wave(check: MountingCheck, azimuth: FloatArray) -> FloatArray:
    turn = np.zeros(2) if check.turn is None else -check.turn
    return np.asarray(np.degrees(np.cos(azimuth) * turn[0] + np.sin(azimuth) * turn[1]))
