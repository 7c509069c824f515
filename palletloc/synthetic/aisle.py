"""Aisles drawn at random: a rack with pallets, and what makes finding them hard."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from palletloc.choices import Illumination, Side
from palletloc.geometry import LevelPose
from palletloc.pallet import Opening, PalletModel
from palletloc.synthetic.lighting import light_of
from palletloc.synthetic.loads import Load, load_on, stack
from palletloc.synthetic.materials import PLASTICS, WOODS
from palletloc.synthetic.pallet_solid import PalletBody
from palletloc.synthetic.placing import ShelfFrame, seeded, standing
from palletloc.synthetic.scene import Scene, Solid
from palletloc.synthetic.surroundings import Rack, bays, draw_clutter, draw_hall, places, rack_boxes

_MOULDED_RADIUS = 0.006
"""Edge radius from which a pallet is taken for moulded plastic, in metres: wood of the library has 3 mm."""
_LEAST_GAP = 0.1
"""Between loads and to uprights, in metres: EN 15620 asks for 75 to 100 mm."""
_INSIDE = 3.0
"""How much less exactly blocks are set inside a pallet than in its face."""
_DRAWS = 100
"""How often a misfit is drawn again that leaves no pallet; more would hide that it is too large."""


@dataclass(frozen=True, slots=True)
class AisleSpec:
    """What kind of aisle to draw."""

    models: tuple[PalletModel, ...]
    """Pallets that may stand in the rack."""
    side: Side = Side.LEFT
    """On which side of the forklift the shelf is."""
    levels: tuple[float, ...] = (0.0, 1.55)
    """Heights that loads stand on, in metres."""
    distance: float = 1.9
    """From the path to the plane of the pallets' fronts, in metres."""
    start: float = -2.0
    """Where the rack begins along the path, in metres."""
    length: float = 10.0
    """Of the rack, in metres."""
    filled: float = 0.75
    """Probability that a place holds a pallet."""
    yaw_sigma: float = 0.02
    """Standard deviation of the pallets' turns against the shelf, in radians; cut off at three of them."""
    setback_sigma: float = 0.03
    """Standard deviation of the fronts' distances from their plane, in metres; cut off at two of them."""
    loads: tuple[Load, ...] = (Load.CARTONS, Load.CARTONS, Load.CARTONS, Load.WRAPPED, Load.CRATE, Load.NONE)
    """What a pallet carries is drawn from these."""
    light: Illumination = Illumination.EVEN
    """How it is lit."""
    occluders: int = 0
    """How many pallets have something standing before them."""
    clutter: int = 4
    """How many things stand around."""
    lines: bool = True
    """Whether there are lines on the floor, one of them along the shelf."""
    opposite: bool = True
    """Whether there is a rack across the aisle, with pallets that do not count."""
    gloss: float = 0.0
    """How much the floor mirrors, 0 to 1."""
    misfit: float = 0.0
    """Shape errors of the pallets, as a multiple of their model's tolerance."""


@dataclass(frozen=True, slots=True)
class StandingPallet:
    """A pallet in the rack."""

    name: str
    """Its own name."""
    model: PalletModel
    """Its model; the body may differ by the misfit."""
    world_from_pallet: LevelPose
    """Where it stands."""


@dataclass(frozen=True, slots=True)
class Aisle:
    """An aisle as drawn."""

    scene: Scene
    """All there is to see."""
    frame: ShelfFrame
    """The true plane of the fronts."""
    pallets: tuple[StandingPallet, ...]
    """Those in the rack beside the path."""


def draw_aisle(spec: AisleSpec, rng: np.random.Generator) -> Aisle:
    """Draw an aisle.

    Parameters
    ----------
    spec : AisleSpec
        The kind.
    rng : numpy.random.Generator
        The only source of randomness: equal states give equal aisles.

    Raises
    ------
    ValueError
        If there is no pallet model or no level.
    """
    if not spec.models or not spec.levels:
        raise ValueError("an aisle needs at least one pallet model and one level")
    frame = ShelfFrame(spec.side, spec.distance)
    solids, pallets = _filled_rack(spec, frame, rng)
    if spec.opposite:
        across = ShelfFrame(spec.side.other, float(spec.distance + rng.uniform(0.0, 0.8)))
        solids += _filled_rack(replace(spec, filled=0.5 * spec.filled), across, rng)[0]
    solids += _occluders(spec, frame, pallets, rng)
    solids += draw_clutter(spec.start, spec.start + spec.length, spec.clutter, rng)
    hall = draw_hall(frame, spec.start, spec.start + spec.length, max(spec.levels), rng)
    if not spec.lines:
        hall = replace(hall, paint=())
    hall = replace(hall, floor=replace(hall.floor, gloss=spec.gloss))
    scene = Scene(hall, light_of(spec.light, rng), tuple(solids))
    return Aisle(scene, frame, tuple(pallets))


def _filled_rack(
    spec: AisleSpec, frame: ShelfFrame, rng: np.random.Generator
) -> tuple[list[Solid], list[StandingPallet]]:
    """Return a rack with its pallets and their loads."""
    height = max(spec.levels) + float(rng.uniform(1.3, 2.2))
    rack = Rack(
        frame,
        bays(spec.length, float(rng.uniform(2.6, 3.3)), spec.start - float(rng.uniform(0.0, 1.5))),
        tuple(level for level in spec.levels if level > 0),
        depth=max(model.depth for model in spec.models) - 0.1,
        setback=float(rng.uniform(0.03, 0.09)),
        height=height,
        upright_width=float(rng.uniform(0.08, 0.12)),
    )
    solids: list[Solid] = [*rack_boxes(rack, rng)]
    pallets: list[StandingPallet] = []
    heights = [*sorted(spec.levels), height]
    for first, second in pairwise(rack.starts):
        for level, ceiling in pairwise(heights):
            chosen = [spec.models[i] for i in rng.integers(len(spec.models), size=4)]
            half = rack.upright_width / 2
            middles = places(first + half, second - half, [m.width for m in chosen], _LEAST_GAP, rng)
            for along, model in zip(middles, chosen, strict=False):
                if rng.random() < spec.filled:
                    pallet = _draw_pallet(spec, frame, model, along, level, f"P{len(pallets) + 1}", rng)
                    pallets.append(pallet)
                    solids += _bodies(spec, pallet, ceiling - level - 0.2, rng)
    return solids, pallets


def _draw_pallet(
    spec: AisleSpec,
    frame: ShelfFrame,
    model: PalletModel,
    along: float,
    level: float,
    name: str,
    rng: np.random.Generator,
) -> StandingPallet:
    yaw = spec.yaw_sigma * float(np.clip(rng.standard_normal(), -3, 3))
    inwards = spec.setback_sigma * float(np.clip(rng.standard_normal(), -2, 2))
    return StandingPallet(name, model, frame.world(inwards, along, level, yaw))


def _bodies(spec: AisleSpec, pallet: StandingPallet, max_height: float, rng: np.random.Generator) -> list[Solid]:
    """Return a pallet's body and its load."""
    moulded = pallet.model.edge_radius >= _MOULDED_RADIUS
    materials = PLASTICS if moulded else WOODS
    material = seeded(materials[rng.integers(len(materials))], rng, 0.1)
    shape = misshapen(pallet.model, spec.misfit, rng)
    load = spec.loads[rng.integers(len(spec.loads))] if spec.loads else Load.NONE
    return [
        PalletBody(pallet.world_from_pallet, shape, material, planks=not moulded),
        *load_on(pallet.world_from_pallet, pallet.model, load, max_height, rng),
    ]


def misshapen(model: PalletModel, misfit: float, rng: np.random.Generator) -> PalletModel:
    """Return a pallet as it was really built: every edge of its face off by a random amount.

    Parameters
    ----------
    model : PalletModel
        As drawn.
    misfit : float
        Standard deviation of the errors, as a multiple of the model's tolerance.
    rng : numpy.random.Generator
        Draws the errors; again where they leave no pallet.

    Raises
    ------
    ValueError
        If even many draws leave none: the misfit is larger than the pallet's parts.
    """
    if misfit <= 0:
        return model
    for _ in range(_DRAWS):
        with suppress(ValueError):
            return _misshapen_once(model, misfit, rng)
    raise ValueError(f"a misfit of {misfit:g} leaves nothing of the pallet model '{model.name}'")


def _misshapen_once(model: PalletModel, misfit: float, rng: np.random.Generator) -> PalletModel:
    def off() -> float:
        return misfit * model.tolerance * float(np.clip(rng.standard_normal(), -2.5, 2.5))

    def shaped(opening: Opening) -> Opening:
        return replace(
            opening, center=opening.center + off(), width=opening.width + off(), height=opening.height + off()
        )

    openings = tuple(shaped(opening) for opening in model.openings)
    least = max((o.bottom + o.height for o in openings), default=0.0) + 0.01
    shape = replace(model, width=model.width + off(), height=max(model.height + off(), least), openings=openings)
    return replace(shape, block_rows=_misplaced(model, misfit * _INSIDE * model.tolerance, rng))


def _misplaced(model: PalletModel, sigma: float, rng: np.random.Generator) -> tuple[tuple[float, float], ...]:
    """Return the rows of blocks with random errors of all places but the first and the last, which are flush."""
    cuts = [cut for row in model.block_rows for cut in row]
    own = rng.spawn(1)[0]  # leaves what else is drawn as it is
    moved = [cut + sigma * float(np.clip(own.standard_normal(), -2.5, 2.5)) for cut in cuts[1:-1]]
    cuts[1:-1] = sorted(moved)
    return tuple(zip(cuts[::2], cuts[1::2], strict=True))


def _occluders(
    spec: AisleSpec, frame: ShelfFrame, pallets: list[StandingPallet], rng: np.random.Generator
) -> list[Solid]:
    """Return posts and cartons that hide a part of some pallets."""
    solids: list[Solid] = []
    low = [pallet for pallet in pallets if pallet.world_from_pallet.z == min(spec.levels)]
    for index in rng.permutation(len(low))[: spec.occluders].tolist():
        pallet = low[index]
        along = pallet.world_from_pallet.x + float(rng.uniform(-0.45, 0.45)) * pallet.model.width
        foot = frame.world(-float(rng.uniform(0.2, 0.35)), along, 0.0, float(rng.uniform(-0.3, 0.3)))
        width = float(rng.uniform(0.05, 0.2))
        if rng.random() < 0.5:
            post = seeded(PLASTICS[rng.integers(len(PLASTICS))], rng)
            solids.append(standing(foot, (0.0, -width / 2, 0.0), (0.06, width / 2, 2.2), post, 0.004))
        else:
            solids += stack(foot, (-0.15, -width, 0.0), (0.15, width, float(rng.uniform(0.15, 0.4))), rng)
    return solids
