"""The verdict on a mounting: whether the camera still sits as the recording says."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import norm

from calibration.check.mounting import MountingCheck, measure_turn
from calibration.findings import Finding, Severity, exit_code, notes_on_input
from calibration.shelf.plane import CHANCE
from palletloc.io.camera_spec import angles_from_transform
from palletloc.io.recording import read_recording

_SURE = 2.0
"""A turn fails from so many standard deviations on: 5 % of right mountings come near, the tolerance keeps them."""
_OPEN_DEG = 0.3
"""An axis known to no better is open, in degrees: twice the usual tolerance."""
_YAW_TOLERANCE_DEG, _YAW_SURE = 0.5, 3.0
"""Yaw that fails, in degrees and standard deviations: odometry tells it less well than gravity tells tilt."""
_HEIGHT_TOLERANCE, _HEIGHT_SURE = 0.015, 3.0
"""Height that fails, in metres and standard deviations: levels are stated to a centimetre."""


@dataclass(frozen=True, slots=True, eq=False)
class CheckAssessment:
    """A check with its verdict."""

    check: MountingCheck
    """What was found."""
    tolerance: float
    """How far the camera may be turned about x or y, in radians."""
    findings: tuple[Finding, ...]
    """What there is to say."""

    @property
    def exit_code(self) -> int:
        """0 pass, 1 fail, 3 degenerate."""
        return exit_code(self.findings)


def check_mounting(
    folder: Path, tolerance_deg: float = 0.15, on_progress: Callable[[str], None] = lambda _: None
) -> CheckAssessment:
    """Check the mounting that a recording states.

    Parameters
    ----------
    folder : Path
        The recording.
    tolerance_deg : float
        How far the camera may be turned about x or y, in degrees: 0.15 are 5 mm on the floor below.
    on_progress : callable
        Is told what is done next.

    Returns
    -------
    CheckAssessment
        With the findings; `check_page` shows it.

    Raises
    ------
    PalletLocError
        If a file is missing or wrong.
    """
    return assess_check(measure_turn(read_recording(folder), on_progress), float(np.radians(tolerance_deg)))


def assess_check(check: MountingCheck, tolerance: float) -> CheckAssessment:
    """Judge a check; the tolerance of roll and pitch is in radians."""
    findings = (*_findings(check, tolerance), *notes_on_input(check.recording.notes))
    return CheckAssessment(check, tolerance, findings)


def _findings(check: MountingCheck, tolerance: float) -> Iterator[Finding]:
    if check.turn is None:
        yield Finding(
            Severity.DEGENERATE,
            "nothing_seen",
            "no source tells roll and pitch ("
            + ("; ".join(f"{source.method}: {source.why}" for source in check.absent) or "odometry reaches no shot")
            + ")",
            "record where uprights, walls or doors are in view, with enough light",
        )
        return
    sigma = np.degrees(check.sigma)
    if sigma.max() > _OPEN_DEG:
        axis = ("roll", "pitch")[int(sigma.argmax())]
        yield Finding(
            Severity.DEGENERATE,
            "one_axis_open",
            f"{axis} is known to {sigma.max():.2f} degrees only: what is seen is in one direction",
            "record where uprights are in view on more than one side",
        )
    yield from _drift(check, tolerance)
    yield from _contradictions(check)
    yield from _yaw(check)
    yield from _height(check)
    for source in check.absent:
        yield Finding(
            Severity.NOTE, "source_absent", f"{source.method} say nothing: {source.why}", "nothing, the others do"
        )


def _contradictions(check: MountingCheck) -> Iterator[Finding]:
    how = "check that the uprights are plumb, the beams level and the floor even"
    worst = check.worst
    if worst is not None and worst.chance < CHANCE:
        both = f"{worst.first} and {worst.second} contradict each other"
        what = f"{both}; chance leaves that to {worst.chance:.1g} of cases"
        yield Finding(Severity.FAIL, "methods_disagree", what, how)
    elif check.chance < CHANCE:
        what = f"the sources differ by more than they state; chance leaves that to {check.chance:.1g} of cases"
        yield Finding(Severity.FAIL, "methods_disagree", what, how)
    if len(check.yaws) > 1:
        first, second = check.yaws[:2]
        off = abs(first.turn - second.turn) / float(np.hypot(first.sigma, second.sigma))
        if 2 * norm.sf(off) < CHANCE:
            what = f"{first.method} and {second.method} differ in yaw by {off:.1f} standard deviations"
            yield Finding(
                Severity.WARNING, "yaws_disagree", what, "look at the shelf's plan: calibrate shelf draws it"
            )


def _height(check: MountingCheck) -> Iterator[Finding]:
    if check.height is None:
        return
    height, sigma = check.height
    if abs(height) > _HEIGHT_TOLERANCE and abs(height) > _HEIGHT_SURE * sigma:
        what = f"the camera is {1000 * height:+.0f} mm higher than stated (sigma {1000 * sigma:.0f})"
        yield Finding(Severity.FAIL, "height_drift", what, "calibrate the mounting; check levels_m in recording.yaml")


def _drift(check: MountingCheck, tolerance: float) -> Iterator[Finding]:
    if check.turn is None:
        return
    for name, turn, sigma in zip(("roll", "pitch"), check.turn, check.sigma, strict=True):
        if abs(turn) > tolerance and abs(turn) > _SURE * sigma:
            _, angles = angles_from_transform(check.corrected())
            yield Finding(
                Severity.FAIL,
                f"{name}_drift",
                f"the camera is turned by {np.degrees(turn):+.3f} degrees of {name} (sigma {np.degrees(sigma):.3f})",
                f"calibrate the mounting; until then roll, pitch {angles[0]:.3f}, {angles[1]:.3f} degrees fit better",
            )


def _yaw(check: MountingCheck) -> Iterator[Finding]:
    if check.yaw is None:
        yield Finding(
            Severity.NOTE,
            "yaw_unknown",
            "nothing tells whether the camera's yaw has changed",
            "drive along a shelf with pallets or uprights",
        )
        return
    yaw, sigma = check.yaw
    if abs(np.degrees(yaw)) > _YAW_TOLERANCE_DEG and abs(yaw) > _YAW_SURE * sigma:
        yield Finding(
            Severity.FAIL,
            "yaw_drift",
            f"the camera is turned by {np.degrees(yaw):+.2f} degrees of yaw (sigma {np.degrees(sigma):.2f})",
            "calibrate the mounting",
        )
