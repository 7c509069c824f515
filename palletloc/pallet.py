"""Pallet models: the front face of a pallet as forks and a camera see it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

_ROUNDING = 1e-9
"""Slack of the geometric checks for the last digits, in metres: a thinner part is none."""


@dataclass(frozen=True, slots=True)
class Opening:
    """A fork opening in the front face; lengths in metres.

    Raises
    ------
    ValueError
        Where a length is not finite or not positive, where the opening starts below the floor, or where
        its corners are rounder than it is large.

    Examples
    --------
    >>> opening = Opening(center=-0.265, bottom=0.024, width=0.290, height=0.092)
    >>> round(opening.left, 3), round(opening.right, 3), round(opening.top, 3)
    (-0.41, -0.12, 0.116)
    """

    center: float
    """Middle, from the face's middle, to the right seen from the aisle (the pallet's -y)."""
    bottom: float
    """Lower edge above the pallet's underside; 0 for one that is open at the floor."""
    width: float
    """Width."""
    height: float
    """Height."""
    radius: float = 0.0
    """Radius of its corners."""

    def __post_init__(self) -> None:
        """Refuse an opening that cannot be cut."""
        _require_finite("the opening", center=self.center)
        _require_positive("the opening", width=self.width, height=self.height)
        _require_not_negative("the opening", bottom=self.bottom, radius=self.radius)
        _require_room_for_corners("the opening", self.radius, self.width, self.height)

    @property
    def left(self) -> float:
        """Left side, from the face's middle, seen from the aisle, in metres."""
        return self.center - self.width / 2

    @property
    def right(self) -> float:
        """Right side, from the face's middle, seen from the aisle, in metres."""
        return self.center + self.width / 2

    @property
    def top(self) -> float:
        """Upper edge above the pallet's underside, in metres."""
        return self.bottom + self.height

    @property
    def open_below(self) -> bool:
        """Whether the opening reaches the floor: there is no lower edge across it."""
        return self.bottom <= 0.0


@dataclass(frozen=True, slots=True)
class PalletModel:
    """The front face of a pallet; lengths in metres.

    Raises
    ------
    ValueError
        Where a length is not finite or not positive, where there is no opening, where an opening leaves the
        face or touches its outline anywhere but at the floor, where openings overlap or are not given from
        left to right, or where roundings are larger than the parts that they round.

    Examples
    --------
    >>> openings = (Opening(-0.265, 0.024, 0.290, 0.092), Opening(0.265, 0.024, 0.290, 0.092))
    >>> model = PalletModel("t11-plastic", width=1.1, height=0.144, depth=1.1, openings=openings)
    >>> [(round(left, 3), round(right, 3)) for left, right in model.blocks]
    [(-0.55, -0.41), (-0.12, 0.12), (0.41, 0.55)]
    """

    name: str
    """Name in files and reports."""
    width: float
    """Width of the face."""
    height: float
    """Height of the face."""
    depth: float
    """Length of the pallet behind the face."""
    openings: tuple[Opening, ...]
    """From left to right, seen from the aisle."""
    corner_radius: float = 0.0
    """Radius of the corners of the face's outline, as drawn."""
    edge_radius: float = 0.0
    """Rounding of its solid edges: moves the edges that a camera sees."""
    tolerance: float = 0.001
    """How far a real pallet's edges lie from the drawn ones (one standard deviation)."""
    source: str = ""
    """Where the dimensions come from."""
    confirmed: bool = False
    """Whether every dimension of the face stands in the source, or follows from it by adding up."""
    note: str = ""
    """What is assumed, or what else to know before using the model."""
    block_rows: tuple[tuple[float, float], ...] = ()
    """Front and back of each row of blocks, as distances behind the face; every row has the face's blocks.

    The first row, which stands in the face, begins at 0. Empty where nothing is known of what is behind the face.
    """

    def __post_init__(self) -> None:
        """Refuse a face that cannot be built."""
        _require_positive(
            "the face", width=self.width, height=self.height, depth=self.depth, tolerance=self.tolerance
        )
        _require_not_negative("the face", corner_radius=self.corner_radius, edge_radius=self.edge_radius)
        _require_room_for_corners("the face", self.corner_radius, self.width, self.height)
        if not self.openings:
            raise ValueError("the face has no opening for the forks")
        self._require_openings_inside()
        self._require_solid_parts()
        self._require_rows_in_order()

    @property
    def blocks(self) -> tuple[tuple[float, float], ...]:
        """Left and right sides of the solid parts beside the openings, from left to right, in metres."""
        lefts = (-self.width / 2, *(opening.right for opening in self.openings))
        rights = (*(opening.left for opening in self.openings), self.width / 2)
        return tuple(zip(lefts, rights, strict=True))

    def largest_difference(self, other: PalletModel) -> float:
        """Return how far the edges of another model's face lie from this one's at most, in metres.

        Parameters
        ----------
        other : PalletModel
            The other model, with the same middle and the same underside.

        Returns
        -------
        float
            The largest difference; infinite where the faces have different numbers of openings.

        Examples
        --------
        >>> openings = (Opening(-0.265, 0.024, 0.290, 0.092), Opening(0.265, 0.024, 0.290, 0.092))
        >>> model = PalletModel("plastic", width=1.1, height=0.144, depth=1.1, openings=openings)
        >>> wider = PalletModel("wider", width=1.2, height=0.144, depth=1.1, openings=openings)
        >>> round(model.largest_difference(wider), 3)
        0.05
        """
        if len(self.openings) != len(other.openings):
            return math.inf
        return max(abs(own - its) for own, its in zip(self._places(), other._places(), strict=True))

    def _places(self) -> Iterator[float]:
        """Yield where the lines of the face lie, in metres."""
        yield from (self.width / 2, self.height)
        for opening in self.openings:
            yield from (opening.left, opening.right, opening.bottom, opening.top)

    def _require_openings_inside(self) -> None:
        """Check that each opening has solid material at its sides and above, and that none overlap."""
        half = self.width / 2
        for number, opening in enumerate(self.openings, start=1):
            if opening.left <= -half + _ROUNDING or opening.right >= half - _ROUNDING:
                raise ValueError(
                    f"opening {number} spans {opening.left:.4g} to {opening.right:.4g} m, "
                    f"expected inside the face's {-half:.4g} to {half:.4g} m"
                )
            if opening.top >= self.height - _ROUNDING:
                raise ValueError(
                    f"opening {number} reaches up to {opening.top:.4g} m, "
                    f"expected below the face's height of {self.height:.4g} m"
                )
        for number, (first, second) in enumerate(pairwise(self.openings), start=1):
            if second.center <= first.center:
                raise ValueError(f"opening {number + 1} is not to the right of opening {number}")
            if second.left <= first.right + _ROUNDING:
                raise ValueError(
                    f"openings {number} and {number + 1} overlap or touch: {number} ends at "
                    f"{first.right:.4g} m, {number + 1} begins at {second.left:.4g} m"
                )

    def _require_solid_parts(self) -> None:
        """Check that the thinnest board or block is as thick as its two rounded edges."""
        parts = [right - left for left, right in self.blocks]
        parts += [self.height - opening.top for opening in self.openings]
        parts += [opening.bottom for opening in self.openings if not opening.open_below]
        if 2 * self.edge_radius > min(parts) + _ROUNDING:
            raise ValueError(
                f"edge_radius {self.edge_radius:.4g} m is more than half of the thinnest part, {min(parts):.4g} m"
            )

    def _require_rows_in_order(self) -> None:
        """Check that the rows of blocks lie one behind the other within the pallet, the first one in its face."""
        cuts = [0.0]
        for number, (front, back) in enumerate(self.block_rows, start=1):
            _require_finite(f"row {number} of blocks", front=front, back=back)
            if number == 1 and front != 0:
                raise ValueError(f"row 1 of blocks begins {front:.4g} m behind the face, expected 0")
            cuts += [front, back]
        rising = all(second > first for first, second in pairwise(cuts[1:]))
        if not rising or cuts[-1] > self.depth + _ROUNDING:
            shown = ", ".join(f"{cut:.4g}" for cut in cuts[1:])
            raise ValueError(
                f"rows of blocks at {shown} m, expected rising values up to the depth of {self.depth:.4g} m"
            )


def _require_finite(what: str, **lengths: float) -> None:
    for name, length in lengths.items():
        if not math.isfinite(length):
            raise ValueError(f"{what}'s {name} must be a finite number, got {length}")


def _require_positive(what: str, **lengths: float) -> None:
    _require_finite(what, **lengths)
    for name, length in lengths.items():
        if length <= 0:
            raise ValueError(f"{what}'s {name} must be positive, got {length:.4g} m")


def _require_not_negative(what: str, **lengths: float) -> None:
    _require_finite(what, **lengths)
    for name, length in lengths.items():
        if length < 0:
            raise ValueError(f"{what}'s {name} must not be negative, got {length:.4g} m")


def _require_room_for_corners(what: str, radius: float, width: float, height: float) -> None:
    if 2 * radius > min(width, height) + _ROUNDING:
        raise ValueError(
            f"{what}'s corner radius {radius:.4g} m is more than half of its smaller side, {min(width, height):.4g} m"
        )
