"""What is around pallets: racks, the hall with its floor lines and lamps, and clutter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palletloc.choices import Side
from palletloc.geometry import LevelPose
from palletloc.synthetic.loads import stack
from palletloc.synthetic.materials import CEILING, CONCRETES, INK, LAMP, LINES, PAINTS, PLASTERS, PLASTICS, RUBBER
from palletloc.synthetic.placing import ShelfFrame, seeded, standing
from palletloc.synthetic.scene import Box, Decal, Material, Paint, Room

_BEAM_HEIGHT, _BEAM_DEPTH = 0.11, 0.05
"""Of a beam's cross-section, in metres: a common box beam."""
_HOLE_PITCH = 0.075
"""From hole to hole in an upright, in metres: 50 and 75 mm are common."""


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
    """Return uprights, beams and guards of a rack; colours and guards are drawn at random."""
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
    """Return the middles of upright frames along an aisle, from the first on, from pitch to pitch, in metres."""
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


def draw_clutter(start: float, end: float, count: int, rng: np.random.Generator) -> list[Box]:
    """Return some bins and stacks of cartons, drawn at random, beyond both ends of an aisle, in metres."""
    boxes: list[Box] = []
    for _ in range(count):
        x = start - rng.uniform(1.5, 3.5) if rng.random() < 0.5 else end + rng.uniform(0.5, 3.0)
        foot = LevelPose(float(x), float(rng.uniform(-1.5, 1.5)), 0.0, float(rng.uniform(-np.pi, np.pi)))
        depth, width, height = rng.uniform([0.4, 0.4, 0.3], [1.0, 1.0, 1.3]).tolist()
        low, high = (0.0, -width / 2, 0.0), (depth, width / 2, height)
        if rng.random() < 0.5:
            boxes += stack(foot, low, high, rng)
        else:
            boxes.append(standing(foot, low, high, seeded(PLASTICS[rng.integers(len(PLASTICS))], rng), 0.02))
    return boxes


def draw_hall(frame: ShelfFrame, start: float, end: float, top: float, rng: np.random.Generator) -> Room:
    """Return a hall around an aisle, with floor lines and lamps, drawn at random; ends and top level in metres."""
    behind, across = frame.distance + rng.uniform([2.2, 4.0], [5.0, 7.0])
    left, right = (behind, across) if frame.side is Side.LEFT else (across, behind)
    low, high = start - float(rng.uniform(5, 8)), end + float(rng.uniform(4, 8))
    rows = (-0.6 * float(right), 0.1, 0.6 * float(left))
    return Room(
        low=(low, -float(right)),
        high=(high, float(left)),
        height=top + float(rng.uniform(2.8, 4.5)),
        floor=seeded(CONCRETES[rng.integers(len(CONCRETES))], rng, 0.08),
        walls=seeded(PLASTERS[rng.integers(len(PLASTERS))], rng, 0.08),
        ceiling=CEILING,
        paint=(*_lines(frame, start, end, rng), *_tyre_marks(start, end, rng)),
        lamps=tuple(Paint(low + 1.5, y, 0.0, 1.5, 0.25, LAMP, pitch=4.0) for y in rows),
    )


def _lines(frame: ShelfFrame, start: float, end: float, rng: np.random.Generator) -> tuple[Paint, ...]:
    """Return a line along the shelf, and the joints of the floor's slabs."""
    pose = frame.world(-float(rng.uniform(0.1, 0.45)), (start + end) / 2, 0.0)
    line = Paint(
        x=pose.x,
        y=pose.y,
        yaw=float(0.004 * rng.standard_normal()),
        length=end - start + 4.0,
        width=float(rng.uniform(0.05, 0.1)),
        colour=LINES[rng.integers(len(LINES))],
        wear=float(rng.uniform(0.0, 0.9)),
    )
    joint = Paint(start + float(rng.uniform(0, 4)), 0.0, np.pi / 2, 40.0, 0.006, INK, pitch=4.0)
    return line, joint


def _tyre_marks(start: float, end: float, rng: np.random.Generator) -> tuple[Paint, ...]:
    """Return worn dark stripes along the path."""
    return tuple(
        Paint(
            x=float(rng.uniform(start, end)),
            y=float(rng.uniform(-1.0, 1.0)),
            yaw=float(0.08 * rng.standard_normal()),
            length=float(rng.uniform(1.0, 4.0)),
            width=float(rng.uniform(0.04, 0.12)),
            colour=RUBBER,
            wear=float(rng.uniform(1.0, 1.3)),
        )
        for _ in range(3)
    )
