"""The edges of a pallet's front face, and where a camera sees them.

Solid edges are rounded, so the gradient of an image peaks beside the drawn edge: on the occluding contour of the
rounding where the camera cannot see the adjoining surface, and towards the far end of the rounding where it can.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

from palletloc.geometry import FloatArray
from palletloc.pallet import Opening, PalletModel

BLUNT_EDGE = 0.002
"""Uncertainty of an edge with both adjoining surfaces in view, beside that of its rounding, in metres."""
LIT_EDGE = 0.003
"""The same for the edge of a surface that light falls on from above: the brightest line may lie behind it."""


class EdgeKind(StrEnum):
    """Which part of the face an edge belongs to."""

    BOTTOM = "bottom"
    TOP = "top"
    SIDE = "side"
    OPENING_TOP = "opening_top"
    OPENING_BOTTOM = "opening_bottom"
    OPENING_SIDE = "opening_side"


@dataclass(frozen=True, slots=True)
class FaceEdge:
    """A straight edge in the face's coordinates: right and up, in metres, from the middle of its lower edge."""

    kind: EdgeKind
    """The part of the face."""
    start: tuple[float, float]
    """Its left or lower end."""
    end: tuple[float, float]
    """Its right or upper end."""
    outward: tuple[float, float]
    """Unit vector across the edge, out of the solid."""

    @property
    def horizontal(self) -> bool:
        """Whether the edge is level."""
        return self.outward[0] == 0.0

    @property
    def middle(self) -> tuple[float, float]:
        """The point half-way along."""
        return (self.start[0] + self.end[0]) / 2, (self.start[1] + self.end[1]) / 2

    @property
    def length(self) -> float:
        """Length in metres."""
        return self.end[0] - self.start[0] + self.end[1] - self.start[1]


@dataclass(frozen=True, slots=True)
class FaceLine:
    """A straight line on the face: one upright edge, or the level edges that lie on it."""

    kind: EdgeKind
    """The part of the face."""
    edges: tuple[FaceEdge, ...]
    """Its stretches, from left to right."""
    whole: FaceEdge
    """The line from its first to its last end, as one edge."""


@dataclass(frozen=True, slots=True)
class EdgeShift:
    """How far from the drawn edge an image shows it, along the edge's outward normal on the face plane."""

    mean: float
    """Expected shift in metres."""
    sigma: float
    """Standard deviation of the rounding's part of it, the same along the whole edge, in metres."""
    both_seen: bool
    """Whether both surfaces that meet at the edge are in view."""


@lru_cache(maxsize=64)
def face_edges(model: PalletModel) -> tuple[FaceEdge, ...]:
    """Return the straight edges of a model's front face, without its rounded corners.

    Parameters
    ----------
    model : PalletModel
        The pallet.

    Returns
    -------
    tuple of FaceEdge
        Outline first, then each opening from left to right.
    """
    half, height, radius = model.width / 2, model.height, model.corner_radius
    edges = [
        FaceEdge(EdgeKind.TOP, (-half + radius, height), (half - radius, height), (0.0, 1.0)),
        FaceEdge(EdgeKind.SIDE, (-half, radius), (-half, height - radius), (-1.0, 0.0)),
        FaceEdge(EdgeKind.SIDE, (half, radius), (half, height - radius), (1.0, 0.0)),
    ]
    edges += [FaceEdge(EdgeKind.BOTTOM, (left, 0.0), (right, 0.0), (0.0, -1.0)) for left, right in _feet(model)]
    for opening in model.openings:
        edges += _opening_edges(opening)
    return tuple(edges)


@lru_cache(maxsize=64)
def face_lines(model: PalletModel) -> tuple[FaceLine, ...]:
    """Return the lines of a model's front face; openings at different heights give lines of their own.

    Level edges on one line share whatever falsifies them, and together they give its slope: measuring them
    apart would count them as independent witnesses.

    Parameters
    ----------
    model : PalletModel
        The pallet.

    Returns
    -------
    tuple of FaceLine
        In the order of `face_edges`.
    """
    lines: dict[tuple[EdgeKind, float, float], list[FaceEdge]] = {}
    for edge in face_edges(model):
        key = (edge.kind, 0.0, edge.start[1]) if edge.horizontal else (edge.kind, 1.0, edge.start[0])
        lines.setdefault(key, []).append(edge)
    return tuple(
        FaceLine(key[0], tuple(edges), FaceEdge(key[0], edges[0].start, edges[-1].end, edges[0].outward))
        for key, edges in lines.items()
    )


def _feet(model: PalletModel) -> list[tuple[float, float]]:
    """Return the stretches of the lower edge that stand on the floor."""
    half = model.width / 2 - model.corner_radius
    feet, left = [], -half
    for opening in model.openings:
        if opening.open_below:
            feet.append((left, opening.center - opening.width / 2))
            left = opening.center + opening.width / 2
    return [*feet, (left, half)]


def _opening_edges(opening: Opening) -> list[FaceEdge]:
    left, right = opening.center - opening.width / 2, opening.center + opening.width / 2
    low, high, radius = opening.bottom, opening.bottom + opening.height, opening.radius
    foot = low if opening.open_below else low + radius
    edges = [
        FaceEdge(EdgeKind.OPENING_TOP, (left + radius, high), (right - radius, high), (0.0, -1.0)),
        FaceEdge(EdgeKind.OPENING_SIDE, (left, foot), (left, high - radius), (1.0, 0.0)),
        FaceEdge(EdgeKind.OPENING_SIDE, (right, foot), (right, high - radius), (-1.0, 0.0)),
    ]
    if not opening.open_below:
        edges.append(FaceEdge(EdgeKind.OPENING_BOTTOM, (left + radius, low), (right - radius, low), (0.0, 1.0)))
    return edges


def contour_shift(radius: float, tangent: float) -> float:
    """Return how far within the drawn edge the occluding contour of its rounding appears, in metres.

    With the angle ``a`` between the viewing direction and the visible surface's normal, or the hidden one's:
    ``r (1 - cos a) + r (1 - sin a) tan a``.

    Parameters
    ----------
    radius : float
        Of the edge, in metres.
    tangent : float
        Of the angle, not negative.
    """
    return radius * (1 + tangent - math.hypot(1.0, tangent))


def edge_shift(edge: FaceEdge, plane_from_camera: FloatArray | Sequence[float], model: PalletModel) -> EdgeShift:
    """Predict where an image shows an edge that is rounded.

    With the tangent ``t`` of the viewing direction across the edge: an edge whose adjoining surface is hidden
    (``t < 0``) appears at the occluding contour of its rounding, ``r (1 - cos a) + r (1 - sin a) tan a`` into the
    solid with ``tan a = -t``; an edge with both surfaces in view between the ends of the rounding, ``-r`` and
    ``r t``, mostly near the far one. A lower edge ends in its own shadow, between contour and drawn edge.

    Parameters
    ----------
    edge : FaceEdge
        The edge.
    plane_from_camera : (3,) array
        The camera's centre in the face's coordinates: right, up, towards the viewer, in metres.
    model : PalletModel
        Gives the edge radius and the tolerance.

    Returns
    -------
    EdgeShift
        Mean and standard deviation.
    """
    middle, outward, radius = edge.middle, edge.outward, model.edge_radius
    across = (plane_from_camera[0] - middle[0]) * outward[0] + (plane_from_camera[1] - middle[1]) * outward[1]
    tangent = float(across / plane_from_camera[2])
    if tangent < 0:
        contour = contour_shift(radius, -tangent)
        if edge.kind is EdgeKind.BOTTOM:
            mean, sigma = -contour / 2, contour / math.sqrt(12.0)
        else:
            mean, sigma = -contour, contour / 4
    else:
        # nothing is sharp about an edge of which both surfaces are seen
        blunt = LIT_EDGE if edge.kind is EdgeKind.OPENING_BOTTOM else BLUNT_EDGE
        mean, sigma = 0.75 * radius * tangent, math.hypot(blunt, radius * (0.1 + 0.15 * tangent))
        if edge.kind is EdgeKind.TOP:  # a load may begin anywhere near it
            sigma += 2 * radius
    return EdgeShift(float(mean), float(sigma), tangent >= 0)


def visible_lines(model: PalletModel, plane_from_camera: FloatArray) -> list[FaceLine]:
    """Return the lines to measure: from below, a beam hides the lower edge and would be taken for it."""
    below = plane_from_camera[1] < 0
    return [line for line in face_lines(model) if not (below and line.kind is EdgeKind.BOTTOM)]
