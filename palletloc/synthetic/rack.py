"""Pallet racks: upright frames, beams, guards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palletloc.synthetic.materials import INK, PAINTS
from palletloc.synthetic.placing import ShelfFrame, standing
from palletloc.synthetic.scene import Box, Decal, Material

_BEAM_HEIGHT, _BEAM_DEPTH = 0.11, 0.05
_HOLE_PITCH = 0.075


@dataclass(frozen=True, slots=True)
class Rack:
    """A row of bays."""

    frame: ShelfFrame
    """Where its front plane is."""
    starts: tuple[float, ...]
    """Middles of its upright frames, along the aisle, in metres."""
    levels: tuple[float, ...]
    """Heights of the beams' upper edges; the floor is none of them, in metres."""
    depth: float
    """From front to rear beam, in metres."""
    setback: float
    """How far the beams stand behind the plane of the pallets' fronts, in metres."""
    height: float
    """Of the uprights, in metres."""
    upright_width: float = 0.1
    """Of the uprights along the aisle, in metres."""


def rack_boxes(rack: Rack, rng: np.random.Generator) -> list[Box]:
    """Return uprights, beams and guards.

    Parameters
    ----------
    rack : Rack
        Where they are.
    rng : numpy.random.Generator
        Draws the colours and the guards.
    """
    uprights, beams = (PAINTS[i] for i in rng.choice(len(PAINTS), 2, replace=False))
    guards = rng.random() < 0.4
    boxes: list[Box] = []
    for start in rack.starts:
        boxes += _upright_frame(rack, start, uprights)
        if guards:
            boxes.append(_guard(rack, start))
    for first, second in pairwise(rack.starts):
        for level in rack.levels:
            boxes += _beams(rack, first, second, level, beams)
    return boxes


def _upright_frame(rack: Rack, start: float, material: Material) -> list[Box]:
    """Return the two posts of a frame with their feet and the braces between them."""
    half = rack.upright_width / 2
    front, back = rack.setback - 0.01, rack.setback + rack.depth
    foot = rack.frame.world(0.0, start, 0.0)
    holes = tuple(Decal(0, -1, (y, 0.0), (0.009, 0.018), INK, _HOLE_PITCH) for y in (-0.024, 0.024))
    boxes = []
    for x in (front, back - 0.07):
        boxes.append(standing(foot, (x, -half, 0.0), (x + 0.07, half, rack.height), material, 0.004, holes))
        boxes.append(standing(foot, (x - 0.02, -half - 0.01, 0.0), (x + 0.1, half + 0.01, 0.006), material))
    boxes += [
        standing(foot, (front + 0.07, -0.02, z), (back - 0.07, 0.02, z + 0.03), material)
        for z in np.arange(0.25, rack.height - 0.1, 0.9).tolist()
    ]
    return boxes


def _beams(rack: Rack, first: float, second: float, level: float, material: Material) -> list[Box]:
    half = (second - first - rack.upright_width) / 2
    foot = rack.frame.world(0.0, (first + second) / 2, level)
    return [
        standing(foot, (x, -half, -_BEAM_HEIGHT), (x + _BEAM_DEPTH, half, 0.0), material, 0.003)
        for x in (rack.setback, rack.setback + rack.depth - _BEAM_DEPTH)
    ]


def _guard(rack: Rack, start: float) -> Box:
    """Return the yellow guard before the foot of an upright."""
    foot = rack.frame.world(rack.setback - 0.12, start, 0.0)
    half = rack.upright_width / 2 + 0.02
    return standing(foot, (0.0, -half, 0.0), (0.05, half, 0.4), PAINTS[2], 0.01)


def bays(length: float, pitch: float, first: float) -> tuple[float, ...]:
    """Return the middles of upright frames along an aisle.

    Parameters
    ----------
    length : float
        To cover, in metres.
    pitch : float
        From frame to frame, in metres.
    first : float
        Middle of the first, in metres.
    """
    return tuple(first + pitch * i for i in range(int(np.ceil(length / pitch)) + 1))


def places(
    first: float, second: float, widths: Sequence[float], margin: float, rng: np.random.Generator
) -> list[float]:
    """Return the middles of loads of given widths between two uprights, with gaps drawn at random.

    Parameters
    ----------
    first, second : float
        Inner edges of the uprights along the aisle, in metres.
    widths : sequence of float
        Of the loads in order, in metres; those that do not fit are left out.
    margin : float
        Least gap, in metres.
    rng : numpy.random.Generator
        Draws the gaps.
    """
    kept: list[float] = []
    for width in widths:
        if sum(kept) + width + margin * (len(kept) + 2) <= second - first:
            kept.append(width)
        else:
            break
    spare = second - first - sum(kept) - margin * (len(kept) + 1)
    gaps = margin + spare * rng.dirichlet(np.ones(len(kept) + 1))
    middles, at = [], first
    for width, gap in zip(kept, gaps, strict=False):
        middles.append(float(at + gap + width / 2))
        at += gap + width
    return middles
