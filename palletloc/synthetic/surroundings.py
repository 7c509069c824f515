"""What is around a rack: the hall with its floor lines and lamps, and clutter."""

from __future__ import annotations

import numpy as np

from palletloc.choices import Side
from palletloc.geometry import LevelPose
from palletloc.synthetic.loads import stack
from palletloc.synthetic.materials import CEILING, CONCRETES, INK, LAMP, LINES, PLASTERS, PLASTICS, RUBBER
from palletloc.synthetic.placing import ShelfFrame, seeded, standing
from palletloc.synthetic.scene import Box, Paint, Room


def draw_clutter(start: float, end: float, count: int, rng: np.random.Generator) -> list[Box]:
    """Return bins and stacks of cartons beyond both ends of an aisle.

    Parameters
    ----------
    start, end : float
        The aisle's ends, in metres.
    count : int
        How many bins and stacks.
    rng : numpy.random.Generator
        Draws them.
    """
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
    """Return a hall around an aisle, with floor lines and lamps.

    Parameters
    ----------
    frame : ShelfFrame
        The shelf beside the path.
    start, end : float
        The aisle's ends, in metres.
    top : float
        Height of its highest level, in metres.
    rng : numpy.random.Generator
        Draws size, materials, lines and lamps.
    """
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
