"""The front of a shelf from a recording without targets: every method that its data allow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from calibration.drive import evenly_spread
from calibration.shelf.beam_line import BEAMS, BeamSearch, beam_lines
from calibration.shelf.front_line import PALLETS, UPRIGHTS
from calibration.shelf.gravity_lines import level_direction, level_heading
from calibration.shelf.landmarks import Landmarks, Skipped, motion_refusal, past_pallets, past_uprights
from calibration.shelf.line_segments import find_segments
from calibration.shelf.plane import Foot, FusedPlane, PlaneEstimate, fuse
from calibration.shelf.plane_sweep import REACH, PlaneSweep, sweep_estimate, sweep_plane
from calibration.shelf.problem import DriveSolution, Observed
from calibration.shelf.upright_edges import Edges
from calibration.shelf.upright_tags import TAGS, TagsOnUprights, tag_places, tag_plane
from palletloc.geometry import FloatArray, wrap_angle
from palletloc.io.recording import Recording
from palletloc.pallet import PalletModel
from palletloc.shelf import ShelfPlane

LINES = "lines"
"""Name of the method that takes only the heading, from level edges."""
_LINE_SHOTS = 8
"""Shots whose level edges are looked for: more take time and show the same edges."""
_ASIDE = np.radians([-50.0, 0.0, 50.0])
"""Where patches look, against straight into the shelf, in radians: 60 degrees each, they overlap a little."""
_BEAM_REACH = 0.1
"""How far before and behind the front beams are looked for, in metres; it must be known as well."""
_BESIDE_PALLET = 0.06
"""How far beside a pallet its load may reach, in metres: a beam is not looked for there."""
_APART = 0.05
"""How far planes of uprights, pallets and beams stand apart where only one is wanted, in metres."""


class Front(StrEnum):
    """What the shelf's front is taken to be."""

    UPRIGHTS = "uprights"
    """The front faces of the uprights."""
    PALLETS = "pallets"
    """The mean of the pallets' fronts, which often hang over."""


@dataclass(frozen=True, slots=True, eq=False)
class ShelfSurvey:
    """What a recording says of its shelf's front."""

    recording: Recording
    """The recording."""
    shots: tuple[int, ...]
    """Which of its shots were used."""
    prior: ShelfPlane
    """What was known before, in odom."""
    front: Front
    """Which plane is wanted."""
    foot: Foot
    """What planes are described from."""
    observed: Observed
    """What poses and landmarks are based on."""
    solution: DriveSolution
    """Poses and landmarks."""
    models: tuple[PalletModel, ...]
    """(m,) of the solution's pallets."""
    edges: Edges
    """Upright edges; their places are the solution's."""
    members: FloatArray
    """(k,) 1 for edges that form the front."""
    estimates: tuple[PlaneEstimate, ...]
    """One for each method that gave something."""
    skipped: tuple[Skipped, ...]
    """The others."""
    fused: FusedPlane | None
    """All together; None where that leaves distance or heading open."""
    sweep: PlaneSweep | None = None
    """At which distances around that shots agree; None where it is not known well enough to look there."""

    @property
    def plane(self) -> ShelfPlane | None:
        """The result in odom, with the prior's levels."""
        if self.fused is None:
            return None
        found = self.foot.plane(self.fused.turn, self.fused.distance)
        return replace(found, levels=self.prior.levels)


def survey_shelf(
    recording: Recording,
    prior: ShelfPlane,
    front: Front = Front.UPRIGHTS,
    tags: TagsOnUprights | None = None,
    on_progress: Callable[[str], None] = lambda _: None,
) -> ShelfSurvey:
    """Find the front of a shelf.

    Parameters
    ----------
    recording : Recording
        Its shelf's entry is not used.
    prior : ShelfPlane
        Roughly the plane, in odom: half a metre and ten degrees.
    front : Front
        Which plane is wanted. Uprights and pallets may be centimetres apart.
    tags : TagsOnUprights, optional
        Tags on the uprights, where there are any.
    on_progress : callable
        Is told what is done next.

    Returns
    -------
    ShelfSurvey
        Also where nothing was found.
    """
    found = past_pallets(recording, prior, on_progress)
    refusal = motion_refusal(found.observed.drive, found.observed.camera, found.foot, prior)
    if refusal is None:
        on_progress("looking for uprights")
        found = past_uprights(found)
    told = _by_landmarks(found, refusal)
    if tags is not None:
        told = told.with_more(_by_tags(found, tags, told.estimates, on_progress))
    told = told.with_more(_by_beams_and_lines(found, told.estimates, on_progress))
    estimates = tuple(estimate.apart(0.0 if _tells(estimate, front) else _APART) for estimate in told.estimates)
    fused = fuse(estimates, _common(recording, estimates)) if estimates else None
    sweep = None
    if fused is not None and fused.covariance[1, 1] < (REACH / 2) ** 2:
        on_progress("moving the plane through its neighbourhood")
        sweep = sweep_plane(recording, found.shots, found.solution.poses, found.foot, fused.turn, fused.distance)
        refined = sweep_estimate(sweep, fused.turn, estimates)
        if refined is not None:
            estimates = (*estimates, refined)
            fused = fuse(estimates, _common(recording, estimates))
    return ShelfSurvey(
        recording,
        found.shots,
        prior,
        front,
        found.foot,
        found.observed,
        found.solution,
        _models(recording, found.observed),
        replace(found.edges, places=found.solution.edges),
        np.zeros(len(found.edges.vote)) if found.line is None else found.line.members.astype(np.float64),
        estimates,
        told.skipped,
        fused,
        sweep,
    )


class _Told(NamedTuple):
    """What methods tell, and why others do not."""

    estimates: tuple[PlaneEstimate, ...]
    skipped: tuple[Skipped, ...] = ()

    def with_more(self, more: _Told) -> _Told:
        """Return both together."""
        return _Told(self.estimates + more.estimates, self.skipped + more.skipped)


def _by_landmarks(found: Landmarks, refusal: Skipped | None) -> _Told:
    """Return the planes of uprights and pallets."""
    pallets, line = found.pallets, found.line
    skipped = [] if refusal is None else [refusal]
    if refusal is None and line is None:
        skipped.append(Skipped(UPRIGHTS, "no_uprights", "no two tall vertical edges line up along the shelf"))
    if pallets is None:
        skipped.append(Skipped(PALLETS, "no_pallets", "no pallet is seen in two shots"))
    planes = (None if line is None else line.estimate, pallets)
    return _Told(tuple(plane for plane in planes if plane is not None), tuple(skipped))


def _by_tags(
    found: Landmarks, tags: TagsOnUprights, before: Sequence[PlaneEstimate], on_progress: Callable[[str], None]
) -> _Told:
    """Return the plane behind tags on the uprights."""
    places = tag_places(found.recording, found.shots, found.solution.poses, tags, on_progress)
    near = before[0].distance if before else found.foot.described(found.prior)[1]
    plane = tag_plane(places, found.foot, tags, near)
    if plane is None:
        return _Told((), (Skipped(TAGS, "no_tags", f"no tag of {tags.dictionary} is seen on the front"),))
    return _Told((plane,))


def _by_beams_and_lines(
    found: Landmarks, before: Sequence[PlaneEstimate], on_progress: Callable[[str], None]
) -> _Told:
    """Return the planes of beams and the heading of level edges, once the front is known to 10 cm."""
    rough = fuse(before) if before else None
    if rough is None or rough.covariance[1, 1] >= _BEAM_REACH**2:
        return _Told(())
    on_progress("looking for beams and level edges")
    search = BeamSearch(found.foot, rough.turn, rough.distance, _BEAM_REACH, _stretches(found))
    beams = beam_lines(found.recording, found.shots, found.solution.poses, search, on_progress)
    missing = Skipped(BEAMS, "no_beams", "no beam of a known height, off the camera's, is seen")
    lines = _lines(found, rough.turn)
    return _Told((*beams, *(() if lines is None else (lines,))), () if beams else (missing,))


def _tells(estimate: PlaneEstimate, front: Front) -> bool:
    """Tell whether a method sees the wanted plane itself."""
    return (estimate.method == PALLETS) == (front is Front.PALLETS)


def _models(recording: Recording, observed: Observed) -> tuple[PalletModel, ...]:
    """Return the model of each pallet in the solution."""
    known = {model.name: model for model in recording.models}
    first = np.unique(observed.pallet_of, return_index=True)[1]
    return tuple(known[observed.pallets[i].model] for i in first)


def _stretches(found: Landmarks) -> FloatArray:
    """Return between which places along the shelf each pallet stands, and at what height, (m, 3)."""
    observed = found.observed
    places = found.foot.local(found.solution.pallets[:, :2])[:, 0]
    heights = np.array([sight.pose.z for sight in observed.pallets])
    rows = []
    for i, (place, model) in enumerate(zip(places, _models(found.recording, observed), strict=True)):
        half = model.width / 2 + _BESIDE_PALLET
        rows.append((place - half, place + half, float(np.median(heights[observed.pallet_of == i]))))
    return np.array(rows).reshape(-1, 3)


def _lines(landmarks: Landmarks, turn: float) -> PlaneEstimate | None:
    """Return the heading of the level edges along the shelf."""
    recording, shots, poses, foot = landmarks.recording, landmarks.shots, landmarks.solution.poses, landmarks.foot
    found = []
    for i in evenly_spread(len(shots), _LINE_SHOTS):
        image = recording.image(recording.shots[shots[i]], gray=True)
        into = foot.yaw + turn - poses[i, 2]
        ahead = [np.array([np.cos(into + a), np.sin(into + a), -0.1]) for a in _ASIDE]
        segments = find_segments(recording.camera, recording.mounting, image, ahead)
        direction = level_direction(segments, float(into - np.pi / 2))
        if direction is not None:
            found.append((direction, float(poses[i, 2])))
    heading = level_heading(found)
    if heading is None:
        return None
    evidence = f"{sum(edges.segments for edges, _ in found)} level edges in {len(found)} shots"
    off = float(wrap_angle(heading[0] + np.pi / 2 - foot.yaw))
    return PlaneEstimate(LINES, off, float("nan"), np.diag([1 / heading[1] ** 2, 0.0]), evidence)


def _common(recording: Recording, estimates: Sequence[PlaneEstimate]) -> FloatArray:
    """Return what the mounting's uncertainty makes of turn and distance, whatever the method."""
    distance = next((estimate.distance for estimate in estimates if np.isfinite(estimate.distance)), 2.0)
    x, y, _, roll, pitch, yaw = recording.mounting.sigma
    tilt = float(np.hypot(roll, pitch)) * distance
    return np.diag([yaw**2, max(x, y) ** 2 + tilt**2])
