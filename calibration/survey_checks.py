"""Faults of a survey: wrong units, wrong corners, and axes that are mirrored or swapped."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration.consensus import own_poses
from calibration.findings import Finding, Severity
from calibration.network import Network, Survey
from palletloc.geometry import FloatArray

_UNITS = {1000.0: "millimetres", 100.0: "centimetres", 39.3701: "inches", 3.28084: "feet"}
_UNIT_TOLERANCE, _SIZE_TOLERANCE, _SIGMAS = 0.05, 0.01, 5.0
_MIRROR_GAIN = 0.3


def size_faults(surveys: Sequence[Survey]) -> list[Finding]:
    """Return for which targets the surveyed corners do not have the size of the pattern.

    Parameters
    ----------
    surveys : sequence of Survey
        Of all targets.
    """
    ratios = {survey.name: _ratio(survey) for survey in surveys}
    for factor, unit in _UNITS.items():
        names = [name for name, ratio in ratios.items() if abs(ratio / factor - 1) < _UNIT_TOLERANCE]
        if names:
            what = f"{_listed(names)}: the surveyed corners are {factor:g} times as far apart as the pattern is large"
            how = f"give corners_m in metres; they seem to be in {unit}"
            return [Finding(Severity.FAIL, "units", what, how)]
        names = [name for name, ratio in ratios.items() if abs(ratio * factor - 1) < _UNIT_TOLERANCE]
        if names:
            what = f"{_listed(names)}: the pattern is {factor:g} times as large as the surveyed corners are apart"
            return [Finding(Severity.FAIL, "units", what, f"give the pattern's sizes in metres, not in {unit}")]
    faults = (_size_fault(survey) for survey in surveys)
    return [fault for fault in faults if fault is not None]


def _ratio(survey: Survey) -> float:
    size = np.linalg.norm(survey.outline[1:] - survey.outline[0])
    return float(np.linalg.norm(survey.points[1:] - survey.points[0]) / size)


def _size_fault(survey: Survey) -> Finding | None:
    """Return which edge or angle of one target's corners is wrong."""
    printed, measured = (p[1:] - p[0] for p in (survey.outline, survey.points))
    wanted, lengths = np.linalg.norm(printed, axis=1), np.linalg.norm(measured, axis=1)
    tolerance = np.maximum(_SIGMAS * np.sqrt(2) * survey.sigma, _SIZE_TOLERANCE * wanted)
    how = "print at true scale (check the ruler), and survey the outer corners of the printed squares"
    for name, length, want, off in zip(("width", "height"), lengths, wanted, tolerance, strict=True):
        if abs(length - want) > off:
            what = f"target {survey.name}: the surveyed {name} is {length:.4f} m, the pattern's is {want:.4f} m"
            return Finding(Severity.FAIL, "target_size", what, how)
    if lengths.min() > 0:
        skew = float(measured[0] @ measured[1] / lengths.prod())
        if abs(skew) > max(_SIGMAS * 2 * survey.sigma / float(lengths.min()), 0.02):
            angle = np.degrees(np.arccos(np.clip(skew, -1, 1)))
            what = f"target {survey.name}: the surveyed corners make an angle of {angle:.1f} degrees, not of 90"
            return Finding(Severity.FAIL, "target_size", what, how)
    return None


def axis_fault(network: Network) -> Finding | None:
    """Return whether the survey fits the targets in the image only when it is mirrored.

    Parameters
    ----------
    network : Network
        With at least two targets.
    """
    own = own_poses(network.sights, len(network.surveys))
    pairs = [(survey, pose) for survey, pose in zip(network.surveys, own, strict=True) if pose is not None]
    if len(pairs) < 2:
        return None
    seen = np.concatenate([pose.apply(survey.outline) for survey, pose in pairs])
    surveyed = np.concatenate([survey.points for survey, _ in pairs])
    rigid, _ = _similarity(seen, surveyed, mirrored=False)
    mirror, mirror_scale = _similarity(seen, surveyed, mirrored=True)
    if mirror < _MIRROR_GAIN * rigid and abs(mirror_scale - 1) < 0.2:
        what = (
            "the survey fits the image only when mirrored: its axes are left-handed"
            f" ({mirror * 1000:.0f} mm instead of {rigid * 1000:.0f} mm)"
        )
        how = "check the order and the signs of the coordinates: x forward, y left, z up"
        return Finding(Severity.FAIL, "mirrored_axes", what, how)
    return None


def _similarity(source: FloatArray, target: FloatArray, *, mirrored: bool) -> tuple[float, float]:
    """Return the distance that remains after the best similarity, in the target's units, and its scale.

    S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", IEEE TPAMI
    13(4), 1991, with the sign of the determinant chosen.
    """
    a, b = source - source.mean(0), target - target.mean(0)
    left, values, right = np.linalg.svd(b.T @ a)
    sign = np.ones(3)
    sign[2] = np.sign(np.linalg.det(left @ right)) * (-1 if mirrored else 1)
    rotation = left * sign @ right
    scale = float(values @ sign / (a * a).sum())
    return float(np.sqrt(((b - scale * a @ rotation.T) ** 2).sum(-1).mean())), scale


def _listed(names: Sequence[str]) -> str:
    return f"target{'s' if len(names) > 1 else ''} {', '.join(names)}"
