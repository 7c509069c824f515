"""What stands on pallets, and what stands around: cartons, crates, wrapped goods."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from palletloc.geometry import LevelPose, level_pose
from palletloc.pallet import PalletModel
from palletloc.synthetic.materials import CARTONS, FILM, INK, LABEL, PLASTICS, TAPE
from palletloc.synthetic.placing import seeded, standing
from palletloc.synthetic.scene import Box, Decal, Material


class Load(StrEnum):
    """What a pallet carries."""

    NONE = "none"
    """Nothing."""
    CARTONS = "cartons"
    """A stack of cartons."""
    WRAPPED = "wrapped"
    """One block in stretch film."""
    CRATE = "crate"
    """One plastic crate."""


def load_on(
    world_from_pallet: LevelPose, model: PalletModel, load: Load, max_height: float, rng: np.random.Generator
) -> list[Box]:
    """Return what a pallet carries.

    Parameters
    ----------
    world_from_pallet : LevelPose
        The pallet.
    model : PalletModel
        Its model.
    load : Load
        The kind.
    max_height : float
        Room above the pallet's underside, in metres.
    rng : numpy.random.Generator
        Draws sizes, gaps, labels and colours.
    """
    room = max_height - model.height - 0.1
    if load is Load.NONE or room < 0.2:
        return []
    height = float(min(rng.uniform(0.3, 1.2), room))
    front, back, side = rng.uniform(-0.01, 0.06), rng.uniform(0.0, 0.05), rng.uniform(-0.005, 0.05)
    low = (float(front), float(-model.width / 2 + side), model.height)
    high = (float(model.depth - back), float(model.width / 2 - side), model.height + height)
    turn = LevelPose(0.0, 0.0, 0.0, 0.006 * float(rng.standard_normal()))
    twist = level_pose(world_from_pallet.transform() * turn.transform())
    if load is Load.CARTONS:
        return stack(twist, low, high, rng)
    if load is Load.WRAPPED:
        return [standing(twist, low, high, seeded(FILM, rng, 0.15), 0.03, _label_on(low, high, rng))]
    material = seeded(PLASTICS[rng.integers(len(PLASTICS))], rng, 0.1)
    return [standing(twist, low, high, material, 0.015, _label_on(low, high, rng))]


def stack(
    world_from_foot: LevelPose,
    low: tuple[float, float, float],
    high: tuple[float, float, float],
    rng: np.random.Generator,
) -> list[Box]:
    """Return cartons that fill a box in layers, without those that nobody can see.

    Parameters
    ----------
    world_from_foot : LevelPose
        The frame of the corners.
    low, high : tuple of float
        Corners of the box, in metres.
    rng : numpy.random.Generator
        Draws sizes, gaps, labels and colours.
    """
    wanted = rng.uniform([0.3, 0.28, 0.18], [0.6, 0.6, 0.4])
    sizes = np.subtract(high, low)
    counts = np.maximum(np.round(sizes / wanted), 1).astype(int)
    material = CARTONS[rng.integers(len(CARTONS))]
    missing = rng.random() < 0.3
    boxes = []
    for i, j, k in np.ndindex(*counts.tolist()):
        top = k == counts[2] - 1
        hidden = 0 < i < counts[0] - 1 and 0 < j < counts[1] - 1 and not (top or missing)
        if hidden or (missing and top and k > 0 and rng.random() < 0.35):
            continue
        corner = np.array(low) + sizes / counts * (i, j, k)
        gap = rng.uniform(0.001, 0.006, 2)
        end = corner + sizes / counts
        first = (float(corner[0] + gap[0]), float(corner[1] + gap[1]), float(corner[2]))
        last = (float(end[0] - gap[0]), float(end[1] - gap[1]), float(end[2] - 0.001))
        boxes.append(_carton(world_from_foot, first, last, material, rng))
    return boxes


def _carton(
    world_from_foot: LevelPose,
    low: tuple[float, float, float],
    high: tuple[float, float, float],
    material: Material,
    rng: np.random.Generator,
) -> Box:
    """Return one carton with its tape and, on some, a label."""
    size = np.subtract(high, low)
    decals: tuple[Decal, ...] = ()
    if rng.random() < 0.6:
        over = Decal(2, 1, (0.0, 0.0), (float(size[0]), 0.05), TAPE)
        decals += (over, Decal(0, -1, (0.0, float(size[2] / 2)), (0.05, 0.14), TAPE))
    if rng.random() < 0.5:
        decals += _label_on(low, high, rng)
    return standing(world_from_foot, low, high, seeded(material, rng, 0.06), 0.004, decals)


def _label_on(
    low: tuple[float, float, float], high: tuple[float, float, float], rng: np.random.Generator
) -> tuple[Decal, ...]:
    """Return a label with lines of print, on the face towards the aisle."""
    size = np.subtract(high, low)
    width = float(min(rng.uniform(0.08, 0.15), 0.5 * size[1]))
    height = float(min(rng.uniform(0.05, 0.1), 0.5 * size[2]))
    y, z = (rng.uniform(-0.5, 0.5, 2) * (size[1:] - (width + 0.02, height + 0.02))).tolist()
    paper = Decal(0, -1, (y, z), (width, height), LABEL)
    stroke = (width * 0.8, height * 0.08)
    return (paper, *(Decal(0, -1, (y, z + height * step), stroke, INK) for step in (-0.3, -0.05, 0.25)))
