"""The verdict on a calibration of lenses: its shots, coverage, misfit and uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from calibration.findings import Finding, Severity
from calibration.intrinsics.board_views import Collected
from calibration.intrinsics.stitched import StitchedFit
from calibration.intrinsics.task import IntrinsicsTask
from calibration.lenses.fit import LensFit, bearing_sigma, hold_out_rms
from calibration.lenses.models import LensCamera
from palletloc.geometry import BoolArray, FloatArray

_FEWEST_VIEWS = 3
"""Fewer boards give no lens."""
SECTORS = 12
"""Of a map of the field, around the axis: 30 degrees each."""
_RING = np.radians(12.0)
"""About the width of the map's rings, in radians: narrower than a board at arm's length."""
_MAX_BEARING_SIGMA = float(np.radians(0.1))
"""A larger standard deviation of bearings fails, in radians; at the rim of the field it is a warning."""
_OPEN_BEARING_SIGMA = float(np.radians(1.0))
"""A larger standard deviation of most bearings, in radians, means that the boards do not tell the lens."""
_BAD_VIEW, _BAD_VIEW_PX = 2.5, 0.3
"""A view is bad that has so many times the usual residual, and so many pixels more: one wrong view among good
ones."""
_NEIGHBOURS, _NEIGHBOURS_AGREE = 2, 0.35
"""Corners that each one is compared with, and the correlation from which on the model misfits: noise alone gives
0."""
_CORRELATED = 0.99
"""Two parameters that correlate more are hardly told apart: their sigmas alone are 7 times those together."""
_LEAST_COVER, _LEAST_REACH = 0.5, 0.7
"""Part of the sectors that must have a corner, and of the way to the rim: below, the model extrapolates."""
_HOLD_OUT = 1.5
"""Views held out may have so many times the residual of the others: a quarter of the shots leave some scatter."""
_MAX_PLACE, _MAX_TURN = 0.005, float(np.radians(0.1))
"""Larger standard deviations of the back lens's place fail, in metres and radians: the mounting's own limits."""
_OPEN_PLACE, _OPEN_TURN = 0.1, float(np.radians(2.0))
"""The same, above which the boards do not tell the place at all."""
_LEAST_GAIN = 0.97
"""Residuals after the correction over those before: no smaller gain than 3 % is worth another camera model."""
AROUND = (
    "let boards stand still on all sides, say boards_stand_still, and take shots from several places and headings"
)
"""What helps where boards leave the place of a lens open."""
_TILT, _RIM = "tilt the board by 30 degrees and more in several directions", "bring it to the rim of the image"
"""What helps where boards leave bearings open."""


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Which sectors have a corner."""

    filled: BoolArray
    """(rings, sectors): from the axis outwards, from the image's right over its bottom."""
    max_angle: float
    """Largest angle off axis of any corner, in radians."""
    reach: float
    """How far out in the image corners come, as a share of half its width."""
    angle: FloatArray
    """(n,) of each used corner, off axis, in radians."""
    azimuth: FloatArray
    """(n,) around the axis, from the image's right to its bottom, in radians."""


@dataclass(frozen=True, slots=True, eq=False)
class Checked:
    """A fit with what was found about it."""

    findings: tuple[Finding, ...]
    """In the order of the checks."""
    view_rms: tuple[float, ...]
    """Of each view, over all its corners, in pixels."""
    coverage: tuple[Coverage, ...]
    """Of each lens."""
    angles: tuple[FloatArray, ...]
    """Of each lens: angles off axis up to its farthest corner, in radians."""
    bearing_sigma: tuple[FloatArray, ...]
    """Of each lens: standard deviation of bearings there, in radians."""
    neighbours: float
    """Correlation of the residuals of neighbouring corners; NaN where there are none."""
    hold_out: float
    """Root mean square in pixels of views that the lens was not fitted to; NaN where there are too few views."""


def view_findings(task: IntrinsicsTask, found: Collected) -> list[Finding]:
    """Return what there is to say about the shots of a task before anything is fitted."""
    findings = [
        Finding(Severity.WARNING, "duplicate_view", f"{twin} is the same as {earlier}; it counts once", "take it out")
        for twin, earlier in found.duplicates
    ]
    findings += [
        Finding(Severity.WARNING, "no_board", _no_board(shot, found.reasons.get(shot)), "take it out or again")
        for shot in found.empty
    ]
    for lens in range(task.lenses):
        count = sum(view.lens == lens for view in found.views)
        if count < _FEWEST_VIEWS:
            what = f"lens {lens}: {count} boards are seen; a lens needs {_FEWEST_VIEWS} at least, better 15"
            how = "take more shots, and check the numbers of the boards in intrinsics.yaml"
            findings.append(Finding(Severity.DEGENERATE, "few_views", what, how))
    return findings


def _no_board(shot: str, reason: str | None) -> str:
    return f"{shot} shows no whole board" + (f"; {reason}" if reason else "")


def check_fit(fit: LensFit, cameras: Sequence[LensCamera], apertures: Sequence[float]) -> Checked:
    """Return what there is to say about a fit, by the camera of each lens and the width of what it shows, in px."""
    parameters, _, _ = fit.problem.columns()
    coverage = tuple(
        _coverage_of(fit, lens, camera, aperture)
        for lens, (camera, aperture) in enumerate(zip(cameras, apertures, strict=True))
    )
    angles = tuple(np.linspace(0.02, cover.max_angle, 25) for cover in coverage)
    sigmas = tuple(
        bearing_sigma(model, values, fit.covariance[at, at], angle)
        for model, values, at, angle in zip(fit.problem.models, fit.rig.values, parameters, angles, strict=True)
    )
    view_rms = tuple(float(np.sqrt((part**2).sum(-1).mean())) for part in fit.residuals)
    neighbours = _neighbour_correlation(fit)
    held = hold_out_rms(fit)
    findings = [
        *_uncertain(sigmas, angles),
        *_bad_views(fit, view_rms),
        *_misfit(neighbours),
        *_held_out(fit, held),
        *_correlated(fit),
        *_covered(coverage),
    ]
    return Checked(tuple(findings), view_rms, coverage, angles, sigmas, neighbours, held)


def _coverage_of(fit: LensFit, lens: int, camera: LensCamera, aperture: float) -> Coverage:
    """Return where the used corners of a lens are."""
    rays = fit.corner_rays(lens)
    angle = np.arctan2(np.hypot(rays[:, 1], rays[:, 2]), rays[:, 0])
    azimuth = np.arctan2(-rays[:, 2], -rays[:, 1]) % (2 * np.pi)
    rings = max(1, round(float(angle.max()) / _RING))
    ring = np.minimum((angle / angle.max() * rings).astype(np.intp), rings - 1)
    sector = np.minimum((azimuth / (2 * np.pi) * SECTORS).astype(np.intp), SECTORS - 1)
    filled = np.zeros((rings, SECTORS), dtype=np.bool_)
    filled[ring, sector] = True
    pixels = np.concatenate(
        [v.pixels[used] for v, used in zip(fit.problem.views, fit.used, strict=True) if v.lens == lens]
    )
    radius = float(np.linalg.norm(pixels - (camera.cx, camera.cy), axis=-1).max())
    return Coverage(filled, float(angle.max()), radius / (aperture / 2), angle, azimuth)


def check_stitched(fit: StitchedFit) -> list[Finding]:
    """Return what there is to say about the lenses behind stitched shots, by the correction of these."""
    _, sigma = fit.between
    turn, place = float(sigma[:3].max()), float(sigma[3:].max())
    what = f"the back lens's place is known to {1000 * place:.1f} mm and {np.degrees(turn):.2f} degrees only"
    if place > _OPEN_PLACE or turn > _OPEN_TURN:
        return [Finding(Severity.DEGENERATE, "unobservable", what, AROUND)]
    findings = []
    if place > _MAX_PLACE or turn > _MAX_TURN:
        findings.append(Finding(Severity.FAIL, "too_uncertain", what, AROUND))
    if fit.after.rms() > _LEAST_GAIN * fit.before.rms():
        what = f"the residuals stay as they are: {fit.before.rms():.3f} px before, {fit.after.rms():.3f} px after"
        findings.append(Finding(Severity.NOTE, "no_gain", what, "keep the camera model equirectangular"))
    return findings


def _uncertain(sigmas: Sequence[FloatArray], angles: Sequence[FloatArray]) -> list[Finding]:
    findings = []
    for lens, (sigma, angle) in enumerate(zip(sigmas, angles, strict=True)):
        usual, worst = float(np.median(sigma)), int(np.argmax(sigma))
        if sigma[worst] < _MAX_BEARING_SIGMA:
            continue
        what = (
            f"bearings of lens {lens} are known to {np.degrees(usual):.2f} degrees as a rule, and to"
            f" {np.degrees(sigma[worst]):.2f} at {np.degrees(angle[worst]):.0f} degrees off axis"
        )
        if usual > _OPEN_BEARING_SIGMA:
            finding = Finding(Severity.DEGENERATE, "unobservable", what, f"{_TILT}, and {_RIM}")
        elif usual > _MAX_BEARING_SIGMA:
            finding = Finding(Severity.FAIL, "too_uncertain", what, f"{_TILT}, and {_RIM}")
        else:
            finding = Finding(Severity.WARNING, "uncertain_rim", what, f"{_RIM}, or state a smaller max_angle_deg")
        findings.append(finding)
    return findings


def _bad_views(fit: LensFit, view_rms: Sequence[float]) -> list[Finding]:
    usual = float(np.median(view_rms))
    findings = []
    for view, rms, used in zip(fit.problem.views, view_rms, fit.used, strict=True):
        if rms > max(_BAD_VIEW * usual, usual + _BAD_VIEW_PX) or not used.any():
            what = f"view {view.name}: {rms:.2f} px, the others {usual:.2f} px; {int((~used).sum())} corners left out"
            how = "look at it: blurred, reflecting, bent, or a corner taken for another; take it out or again"
            findings.append(Finding(Severity.WARNING, "bad_view", what, how))
    for name in fit.dropped:
        what = f"view {name}: its corners give no pose"
        findings.append(Finding(Severity.WARNING, "bad_view", what, "look at it, and take it out or again"))
    return findings


def _neighbour_correlation(fit: LensFit) -> float:
    """Return how much residuals agree between neighbouring corners of a board."""
    products, squares = 0.0, 0.0
    for view, used, residual in zip(fit.problem.views, fit.used, fit.residuals, strict=True):
        if used.sum() <= _NEIGHBOURS:
            continue
        near = np.asarray(KDTree(view.points[used]).query(view.points[used], k=_NEIGHBOURS + 1)[1])
        own = residual[used]
        products += float((own[:, None] * own[near[:, 1:]]).sum())
        squares += _NEIGHBOURS * float((own**2).sum())
    return products / squares if squares > 0 else float("nan")


def _misfit(neighbours: float) -> list[Finding]:
    if not neighbours > _NEIGHBOURS_AGREE:
        return []
    what = f"residuals of neighbouring corners agree (correlation {neighbours:.2f}): the model does not fit the lens"
    how = "try another model: kannala_brandt for fisheyes, mei where the lens is not centred or a mirror is used"
    return [Finding(Severity.WARNING, "model_misfit", what, how)]


def _held_out(fit: LensFit, held: float) -> list[Finding]:
    if not held > _HOLD_OUT * fit.rms():
        return []
    what = f"views that the lens was not fitted to have {held:.2f} px, the others {fit.rms():.2f} px"
    return [Finding(Severity.WARNING, "hold_out", what, "take more shots, in all parts of the image")]


def _correlated(fit: LensFit) -> list[Finding]:
    names, correlation = fit.problem.names(), fit.correlation
    findings = []
    for lens, model in enumerate(fit.problem.models):
        if "xi" not in model.shape:
            continue
        first = fit.problem.columns()[0][lens].start
        value = float(correlation[first, first + 4])
        if abs(value) > _CORRELATED:
            what = (
                f"{names[first]} and {names[first + 4]} are hardly told apart (correlation {value:.4f}); bearings are"
                " not worse for it, but the two numbers mean nothing alone"
            )
            how = "nothing, or choose kannala_brandt or eucm"
            findings.append(Finding(Severity.WARNING, "correlated", what, how))
    return findings


def _covered(coverage: Sequence[Coverage]) -> list[Finding]:
    findings = []
    for lens, cover in enumerate(coverage):
        share = float(cover.filled.mean())
        if share < _LEAST_COVER or cover.reach < _LEAST_REACH:
            what = (
                f"lens {lens}: corners fill {100 * share:.0f} % of the field and reach"
                f" {np.degrees(cover.max_angle):.0f} degrees off axis, {100 * cover.reach:.0f} % of the way to the"
                " rim of the image"
            )
            how = "take shots with the board in the empty sectors of the coverage map"
            findings.append(Finding(Severity.WARNING, "coverage", what, how))
    return findings
