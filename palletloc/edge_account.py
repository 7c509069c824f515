"""What became of every edge of a face in the fit of its pose: the account that pictures and files share."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from palletloc.face import EdgeKind, FaceEdge, FaceLine
from palletloc.face_view import visible_lines
from palletloc.pallet import PalletModel
from palletloc.refinement.alignment import FaceEstimate
from palletloc.refinement.edges import MeasuredEdge
from palletloc.refinement.system import USED_WEIGHT


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
        one = self.measured
        return float("nan") if one is None else float(np.hypot(one.sigma, one.shift.sigma))


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
    measured = {one.edge: (one, float(weight)) for one, weight in zip(face.seen.edges, face.weights, strict=True)}
    accounts = []
    for number, line in enumerate(visible_lines(model, face.seen.plane_from_camera), start=1):
        one, weight = measured.get(line.whole, (None, 0.0))
        fate = _fate(line, weight if one is not None else None, face.hidden)
        name, loaded = edge_name(model, line.whole), face.seen.loaded(line.whole)
        accounts.append(EdgeAccount(number, name, line.whole, fate, loaded, one, weight))
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
