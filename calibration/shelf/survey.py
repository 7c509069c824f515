"""The front of a shelf from a recording without targets: every method that its data allow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from calibration.drive import Drive, compose, read_drive
from calibration.shelf.beam_line import BEAMS, BeamSearch, beam_lines
from calibration.shelf.edge_sights import measure_edges, triangulated
from calibration.shelf.front_line import PALLETS, UPRIGHTS, FrontLine, pallet_line, upright_line
from calibration.shelf.gravity_lines import level_direction, level_heading
from calibration.shelf.level_view import LevelView, level_view
from calibration.shelf.line_segments import find_segments
from calibration.shelf.pallets import PalletSight, see_again, see_pallets
from calibration.shelf.plane import Foot, FusedPlane, PlaneEstimate, fuse
from calibration.shelf.plane_sweep import REACH, PlaneSweep, sweep_estimate, sweep_plane
from calibration.shelf.problem import DriveSolution, Observed, same_pallets, solve
from calibration.shelf.shots import Skipped, motion_refusal, usable_shots
from calibration.shelf.upright_edges import Edges, find_edges
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
_NEAR_DEPTH, _FAR_DEPTH = 0.2, 0.6
"""How far uprights are looked for before and behind the plane, in metres: after pallets, and without them."""
_KNOWN_TURN, _ROUGH_TURN = float(np.radians(1.2)), float(np.radians(6.0))
"""How well the heading is known, in radians: after pallets, and without them."""
_BIASES = np.arange(-0.009, 0.0091, 0.001)
"""Biases of the gyroscope that are tried, in radians per second: a standard deviation of the odometry's."""
_ROUNDS = 3
"""How often uprights are found again by the poses that they give, where there are no pallets."""


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
    shots = usable_shots(recording)
    drive = read_drive(recording.odometry, [recording.shots[i].time for i in shots])
    camera = np.asarray(recording.mounting.center[:2], dtype=np.float64)
    observed, solution, foot = _pallets(recording, shots, drive, prior, on_progress)
    pallets = pallet_line(solution.pallets, solution.landmark_covariance()[0], foot)
    skipped: list[Skipped] = []
    edges, line = Edges.none(), None
    refusal = motion_refusal(drive, camera, foot, prior)
    if refusal is not None:
        skipped.append(refusal)
    else:
        on_progress("looking for uprights")
        observed, solution, edges, line = _uprights(recording, shots, observed, solution, foot, pallets, prior)
        if line is None:
            skipped.append(Skipped(UPRIGHTS, "no_uprights", "no two tall vertical edges line up along the shelf"))
        pallets = pallet_line(solution.pallets, solution.landmark_covariance()[0], foot)
    if pallets is None:
        skipped.append(Skipped(PALLETS, "no_pallets", "no pallet is seen in two shots"))
    estimates = [estimate for estimate in (None if line is None else line.estimate, pallets) if estimate is not None]
    if tags is not None:
        places = tag_places(recording, shots, solution.poses, tags, on_progress)
        tagged = tag_plane(places, foot, tags, estimates[0].distance if estimates else foot.described(prior)[1])
        estimates += [] if tagged is None else [tagged]
        if tagged is None:
            skipped.append(Skipped(TAGS, "no_tags", f"no tag of {tags.dictionary} is seen on the front"))
    rough = fuse(estimates) if estimates else None
    if rough is not None and rough.covariance[1, 1] < _BEAM_REACH**2:
        on_progress("looking for beams and level edges")
        search = BeamSearch(
            foot, rough.turn, rough.distance, _BEAM_REACH, _stretches(recording, observed, solution, foot)
        )
        beams = beam_lines(recording, shots, solution.poses, search, on_progress)
        if not beams:
            skipped.append(Skipped(BEAMS, "no_beams", "no beam of a known height, off the camera's, is seen"))
        lines = _lines(recording, shots, solution.poses, foot, rough.turn)
        estimates += beams if lines is None else [*beams, lines]
    estimates = [estimate.apart(0.0 if _tells(estimate, front) else _APART) for estimate in estimates]
    fused = fuse(estimates, _common(recording, estimates)) if estimates else None
    sweep = None
    if fused is not None and fused.covariance[1, 1] < (REACH / 2) ** 2:
        on_progress("moving the plane through its neighbourhood")
        sweep = sweep_plane(recording, shots, solution.poses, foot, fused.turn, fused.distance)
        refined = sweep_estimate(sweep, fused.turn, estimates)
        if refined is not None:
            estimates.append(refined)
            fused = fuse(estimates, _common(recording, estimates))
    members = np.zeros(len(edges.vote)) if line is None else line.members.astype(np.float64)
    return ShelfSurvey(
        recording,
        tuple(shots),
        prior,
        front,
        foot,
        observed,
        solution,
        _models(recording, observed),
        replace(edges, places=solution.edges),
        members,
        tuple(estimates),
        tuple(skipped),
        fused,
        sweep,
    )


def _tells(estimate: PlaneEstimate, front: Front) -> bool:
    """Tell whether a method sees the wanted plane itself."""
    return (estimate.method == PALLETS) == (front is Front.PALLETS)


def _models(recording: Recording, observed: Observed) -> tuple[PalletModel, ...]:
    """Return the model of each pallet in the solution."""
    known = {model.name: model for model in recording.models}
    first = np.unique(observed.pallet_of, return_index=True)[1]
    return tuple(known[observed.pallets[i].model] for i in first)


def _stretches(recording: Recording, observed: Observed, solution: DriveSolution, foot: Foot) -> FloatArray:
    """Return between which places along the shelf each pallet stands, and at what height, (m, 3)."""
    places = foot.local(solution.pallets[:, :2])[:, 0]
    heights = np.array([sight.pose.z for sight in observed.pallets])
    rows = []
    for i, (place, model) in enumerate(zip(places, _models(recording, observed), strict=True)):
        half = model.width / 2 + _BESIDE_PALLET
        rows.append((place - half, place + half, float(np.median(heights[observed.pallet_of == i]))))
    return np.array(rows).reshape(-1, 3)


def _lines(
    recording: Recording, shots: list[int], poses: FloatArray, foot: Foot, turn: float
) -> PlaneEstimate | None:
    """Return the heading of the level edges along the shelf."""
    found = []
    for i in np.unique(np.linspace(0, len(shots) - 1, min(len(shots), _LINE_SHOTS)).round().astype(int)):
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


def _pallets(
    recording: Recording, shots: list[int], drive: Drive, prior: ShelfPlane, on_progress: Callable[[str], None]
) -> tuple[Observed, DriveSolution, Foot]:
    """Return the drive past the pallets: seen widely first, then once more by the poses that gives."""
    camera = np.asarray(recording.mounting.center[:2], dtype=np.float64)
    sights, _ = see_pallets(recording, shots, prior, on_progress)
    observed = Observed(drive, camera, *_joined(drive, sights))
    solution = solve(observed)
    foot = _foot(solution, camera, prior)
    line = pallet_line(solution.pallets, solution.landmark_covariance()[0], foot)
    if line is None:
        return observed, solution, foot
    on_progress("localizing pallets once more")
    plane = replace(foot.plane(line.turn, line.distance), levels=prior.levels)
    again = _joined(drive, see_again(recording, shots, solution.poses, plane))
    if len(again[0]) < len(observed.pallets) / 2:
        return observed, solution, foot
    observed = Observed(drive, camera, *again)
    solution = solve(observed)
    return observed, solution, _foot(solution, camera, prior)


def _joined(drive: Drive, sights: Sequence[PalletSight]) -> tuple[tuple[PalletSight, ...], NDArray[np.intp]]:
    kept, owner = same_pallets(drive, sights)
    return tuple(kept), owner


def _foot(solution: DriveSolution, camera: FloatArray, prior: ShelfPlane) -> Foot:
    """Return the camera's place at the middle of the way, with the heading that the pallets give."""
    middle = solution.poses[len(solution.poses) // 2]
    point = compose(middle, np.array([*camera, 0.0]))[:2]
    if not len(solution.pallets):
        return Foot(point, prior.yaw)
    turned = np.asarray(wrap_angle(solution.pallets[:, 2] - prior.yaw))
    foot = Foot(point, prior.yaw + float(np.median(turned)))
    line = pallet_line(solution.pallets, solution.landmark_covariance()[0], foot)
    return foot if line is None else Foot(point, foot.yaw + line.turn)


def _uprights(
    recording: Recording,
    shots: list[int],
    observed: Observed,
    solution: DriveSolution,
    foot: Foot,
    pallets: PlaneEstimate | None,
    prior: ShelfPlane,
) -> tuple[Observed, DriveSolution, Edges, FrontLine | None]:
    rough = foot.plane(pallets.turn, pallets.distance) if pallets else prior
    poses = solution.poses
    views = _views(recording, shots, poses, foot, rough)
    depth = _NEAR_DEPTH if pallets else _FAR_DEPTH
    if pallets is None:
        poses = _least_blurred(views, observed.drive, rough)
    turn_sigma = min(_KNOWN_TURN, 1.5 * pallets.sigma[0]) if pallets else _ROUGH_TURN
    for _ in range(
        1 if pallets else _ROUNDS
    ):  # without pallets the first poses are rough: once more by the solved ones
        edges = find_edges(views, poses, rough, depth)
        sights = measure_edges(views, poses, edges, rough.yaw)
        edges, sights = triangulated(views, poses, edges, sights)
        if not len(edges.vote):
            return observed, solution, Edges.none(), None
        seen = replace(observed, edges=tuple(sights))
        solution = solve(seen, edges.places)
        poses = solution.poses
    line = upright_line(edges, solution.edges, solution.landmark_covariance()[1], foot, turn_sigma)
    return seen, solution, edges, line


def _views(
    recording: Recording, shots: list[int], poses: FloatArray, foot: Foot, rough: ShelfPlane
) -> list[LevelView]:
    distance = max(foot.described(rough)[1], 0.3)
    views = []
    for index, pose in zip(shots, poses, strict=True):
        image = recording.image(recording.shots[index], gray=True)
        towards = float(wrap_angle(rough.yaw - pose[2]))
        views.append(level_view(recording.camera, recording.mounting, image, towards, distance))
    return views


def _least_blurred(views: list[LevelView], drive: Drive, rough: ShelfPlane) -> FloatArray:
    """Return the poses, without the gyroscope's bias, at which most shots agree on upright edges."""
    tried = [drive.poses(bias=float(bias)) for bias in _BIASES]
    sharp = [float(np.sort(np.abs(find_edges(views, poses, rough, _FAR_DEPTH).vote))[-12:].sum()) for poses in tried]
    return tried[int(np.argmax(sharp))]


def _common(recording: Recording, estimates: Sequence[PlaneEstimate]) -> FloatArray:
    """Return what the mounting's uncertainty makes of turn and distance, whatever the method."""
    distance = next((estimate.distance for estimate in estimates if np.isfinite(estimate.distance)), 2.0)
    x, y, _, roll, pitch, yaw = recording.mounting.sigma
    tilt = float(np.hypot(roll, pitch)) * distance
    return np.diag([yaw**2, max(x, y) ** 2 + tilt**2])
