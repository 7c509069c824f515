"""What pictures, tables and files share of a shot's results: names, the account of edges, axes of a search."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from palletloc.candidate import Fit, Refusal
from palletloc.face import EdgeKind, FaceEdge, FaceLine, visible_lines
from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.localizer import Explanation
from palletloc.measurement import Reason
from palletloc.pallet import PalletModel
from palletloc.refinement.edges import MeasuredEdge
from palletloc.refinement.face_fit import FaceEstimate
from palletloc.refinement.normal_equations import USED_WEIGHT
from palletloc.refinement.patch import FacePatch
from palletloc.verification import USUAL_CONTRAST, VerificationConfig

Named = tuple[tuple[str, Fit | Refusal], ...]
"""What became of candidates, with their names."""
_NOTHING = "nothing, unless you see a pallet there"
"""What to do about refusals that are no loss."""
IN_WORDS: Mapping[str, tuple[str, str]] = {
    Reason.UNKNOWN_MODEL: ("the recording does not name this pallet model", "add it to pallets in recording.yaml"),
    Reason.NOT_FINITE: ("the start has a value that is not a number", "leave such starts out"),
    Reason.OUT_OF_VIEW: (
        "the camera does not see the whole face",
        "check max_angle_deg and the mounting in recording.yaml, where the image shows it",
    ),
    Reason.BEHIND_FACE: ("the camera is behind the face", "check the start's yaw, or the shelf's facing_deg"),
    Reason.OUT_OF_RANGE: ("it is too far away", "drive nearer, or raise detection.max_range"),
    Reason.NO_LINE: ("no line of the pallet gives its yaw", "take the method refined"),
    Reason.NO_PEAK: (
        "no pose within reach fits the image",
        "check the model's dimensions, or widen prior and search",
    ),
    Reason.FEW_EDGES: ("too few edges of the face are seen where they should be", _NOTHING),
    Reason.HIDDEN: ("something stands before most of the face", "try a shot from farther along the aisle"),
    Reason.LOW_CONTRAST: ("openings and blocks do not differ as a pallet's do", f"{_NOTHING}; then expose longer"),
    Reason.OVERLAP: ("a better pallet stands in the same place", "nothing"),
    Reason.YAW_DISAGREES: (
        "its level lines turn it otherwise than all its edges",
        "measure the mounting again, if it happens often",
    ),
    Reason.UNCERTAIN: (
        "a pallet, but its pose is too uncertain to be of use",
        "drive nearer, give levels_m, measure the mounting better, or measure the pallet",
    ),
    Reason.OFF_LEVEL: ("it stands at no height where loads stand", "measure levels_m again"),
    Reason.OTHER_MODEL: (
        "a pallet of a model that the recording does not name fits better",
        "correct pallets in recording.yaml, or measure the pallet",
    ),
}
"""What each reason means, and what to do about it; ``docs/refusals.md`` has more."""


def name_candidates(explanation: Explanation) -> Named:
    """Give candidates short names: P1, P2, ... to pallets from left to right, C1, C2, ... to the others.

    Parameters
    ----------
    explanation : Explanation
        Of a shot.

    Returns
    -------
    tuple of (str, Fit or Refusal)
        Pallets first; the others by score, best first.
    """
    found = [outcome for outcome in explanation.outcomes if isinstance(outcome, Fit)]
    others = [outcome for outcome in explanation.outcomes if isinstance(outcome, Refusal)]
    found.sort(key=lambda fit: float(np.arctan2(fit.pose.y, fit.pose.x)), reverse=True)
    others.sort(key=lambda refusal: refusal.candidate.score, reverse=True)
    return (
        *((f"P{i}", fit) for i, fit in enumerate(found, start=1)),
        *((f"C{i}", refusal) for i, refusal in enumerate(others, start=1)),
    )


def given_up(outcome: Fit | Refusal) -> str:
    """Return what a title states of a candidate that was given up: where and why; nothing for a pallet."""
    if isinstance(outcome, Fit):
        return ""
    return f" (given up in {outcome.stage}: {str(outcome.reason).replace('_', ' ')})"


def spoke_against(refusal: Refusal, config: VerificationConfig | None = None) -> str:
    """Return what spoke against a candidate that had a pose, in words and numbers.

    Parameters
    ----------
    refusal : Refusal
        With what had been measured.
    config : VerificationConfig, optional
        The limits that held; the defaults if left out.

    Returns
    -------
    str
        What the reason means, and the numbers behind it; the meaning alone where there are none.
    """
    limits, fit = config or VerificationConfig(), refusal.fit
    means = IN_WORDS[refusal.reason][0]
    if refusal.better is not None:
        return f"{means}: {refusal.better}"
    if fit is None:
        return means
    if refusal.reason is Reason.UNCERTAIN:
        place = 1000 * float(np.sqrt(np.linalg.eigvalsh(fit.covariance[:2, :2])[-1]))
        turn = float(np.degrees(np.sqrt(fit.covariance[3, 3])))
        asked = f"{1000 * limits.max_sigma:.0f} mm and {limits.max_yaw_sigma_deg:g} degrees are allowed"
        return f"{means}: sigma {place:.0f} mm on the floor, {turn:.2f} degrees of yaw; {asked}"
    if fit.evidence is None or refusal.reason not in (Reason.LOW_CONTRAST, Reason.FEW_EDGES):
        return means
    seen = fit.evidence
    signs = f"contrast {seen.contrast:.1f} (pallets: {USUAL_CONTRAST:g} and more), {100 * seen.coverage:.0f} % of the"
    signs += f" edges seen, {seen.doubt:.1f} missing or contradicting, {100 * seen.hidden:.0f} % hidden"
    return f"{means}: {signs}; probability {seen.probability:.2f}, {limits.min_rank:g} is needed"


class EdgeFate(StrEnum):
    """What the fit made of an edge."""

    USED = "used"
    """Measured, and in agreement with the others."""
    REJECTED = "rejected"
    """Measured, but in contradiction to the others."""
    NOT_SEEN = "not_seen"
    """Expected, but too little of it was found."""
    HIDDEN = "hidden"
    """Something stands before it."""


@dataclass(frozen=True, slots=True)
class EdgeAccount:
    """One line of the face with what became of it."""

    number: int
    """From 1, the same in every picture and file."""
    name: str
    """What people call it."""
    edge: FaceEdge
    """The line, from its first to its last end."""
    fate: EdgeFate
    """What the fit made of it."""
    loaded: bool
    """Whether a load may begin there, which moves what is seen."""
    measured: MeasuredEdge | None
    """What was measured; None where nothing was."""
    weight: float
    """In the robust fit, 0 to 1; 0 where nothing was measured."""

    @property
    def sigma(self) -> float:
        """Standard deviation that the fit gives the offset, rounding of the edge included, in metres; or NaN."""
        measured = self.measured
        return float("nan") if measured is None else float(np.hypot(measured.sigma, measured.shift.sigma))


def account_edges(face: FaceEstimate, model: PalletModel) -> tuple[EdgeAccount, ...]:
    """Return what became of every edge that the camera should see.

    Parameters
    ----------
    face : FaceEstimate
        The fit.
    model : PalletModel
        The pallet.

    Returns
    -------
    tuple of EdgeAccount
        In the order of `palletloc.face.face_lines`.
    """
    weights = zip(face.seen.edges, face.weights, strict=True)
    weighted = {measured.edge: (measured, float(weight)) for measured, weight in weights}
    accounts = []
    for number, line in enumerate(visible_lines(model, face.seen.plane_from_camera), start=1):
        measured, weight = weighted.get(line.whole, (None, 0.0))
        fate = _fate(line, weight if measured is not None else None, face.hidden)
        name, loaded = edge_name(model, line.whole), face.seen.loaded(line.whole)
        accounts.append(EdgeAccount(number, name, line.whole, fate, loaded, measured, weight))
    return tuple(accounts)


def _fate(line: FaceLine, weight: float | None, hidden: tuple[FaceEdge, ...]) -> EdgeFate:
    if line.whole in hidden:
        return EdgeFate.HIDDEN
    if weight is not None:
        return EdgeFate.USED if weight > USED_WEIGHT else EdgeFate.REJECTED
    return EdgeFate.HIDDEN if any(edge in hidden for edge in line.edges) else EdgeFate.NOT_SEEN


def edge_name(model: PalletModel, edge: FaceEdge) -> str:
    """Return what people call an edge: ``"left side"``, ``"opening 2, left side"``, ``"openings' upper edges"``.

    Parameters
    ----------
    model : PalletModel
        The pallet; openings count from left to right as seen from the aisle.
    edge : FaceEdge
        A line of its face.
    """
    if edge.kind is EdgeKind.SIDE:
        return "left side" if edge.outward[0] < 0 else "right side"
    if edge.kind is EdgeKind.OPENING_SIDE:
        side = "left" if edge.outward[0] > 0 else "right"
        middles = [opening.center for opening in model.openings]
        nearest = min(range(len(middles)), key=lambda i: abs(middles[i] - edge.middle[0]))
        return f"opening {nearest + 1}, {side} side"
    return {
        EdgeKind.BOTTOM: "lower edge",
        EdgeKind.TOP: "upper edge",
        EdgeKind.OPENING_TOP: "openings' upper edges",
        EdgeKind.OPENING_BOTTOM: "openings' lower edges",
    }[edge.kind]


@dataclass(frozen=True, slots=True)
class SearchAxes:
    """Between poses and the table of a search, whose columns are distances along one viewing ray.

    A pose beside that ray has the distance of the point on the ray that is as deep: what it is shifted along the
    shelf does not move it from one column to another.
    """

    base: LevelPose
    """``forklift_from_pallet`` of the middle of the search, which the viewing ray goes through."""
    away: float
    """Ground distance of the camera from it, in metres."""
    depth: float
    """Distance of the camera from the plane of its face, in metres."""

    @classmethod
    def of(cls, patch: FacePatch) -> SearchAxes:
        """Return the axes of a search on a patch."""
        right, _, towards = (float(value) for value in patch.plane_from_camera)
        return cls(patch.base, float(np.hypot(right, towards)), towards)

    def yaws(self, turns: FloatArray) -> FloatArray:
        """Return the yaws of turns against the base, unwrapped, in radians."""
        return self.base.yaw + turns

    def ranges(self, factors: FloatArray) -> FloatArray:
        """Return the ground distances of multiples of the base's, in metres."""
        return self.away * factors

    def place(self, pose: LevelPose) -> FloatArray:
        """Return yaw in radians and ground distance in metres of a pose, (2,); the yaw is that next to the base's."""
        into = np.array([np.cos(self.base.yaw), np.sin(self.base.yaw)])
        behind = float(into @ [pose.x - self.base.x, pose.y - self.base.y])
        yaw = self.base.yaw + wrap_angle(pose.yaw - self.base.yaw)
        return np.array([yaw, self.away * (1 + behind / self.depth)])

    def covariance(self, covariance: FloatArray) -> FloatArray:
        """Return the (2, 2) covariance of `place` from that of (x, y, z, yaw)."""
        per_depth = self.away / self.depth
        change = np.array(
            [[0, 0, 0, 1], [per_depth * np.cos(self.base.yaw), per_depth * np.sin(self.base.yaw), 0, 0]]
        )
        return np.asarray(change @ covariance @ change.T)
