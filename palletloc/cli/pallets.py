"""The command ``palletloc pallets``: which pallet models there are, listed and drawn."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

from palletloc.cli.help import INPUT, RESULTS
from palletloc.cli.showing import Shown, shows
from palletloc.cli.tables import CUT, new_table
from palletloc.errors import PalletLocError

if TYPE_CHECKING:
    from palletloc.pallet import Opening, PalletModel

_TIMES = "\N{MULTIPLICATION SIGN}"
"""Between width and height."""


@shows
def pallets(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME", help="Models to show, with sources in full; all if left out."),
    ] = None,
    file: Annotated[
        Path | None,
        typer.Option(
            "--file", metavar="YAML", rich_help_panel=INPUT, help="Your own pallets.yaml; its models come first."
        ),
    ] = None,
    draw: Annotated[
        Path | None,
        typer.Option(
            "--draw", metavar="PNG", rich_help_panel=RESULTS, help="Draw the models to scale into this file."
        ),
    ] = None,
) -> Shown:
    """List and draw the pallet models."""
    import yaml

    from palletloc.pallet_library import find_models, format_pallets, load_library, read_pallets

    if draw is not None and draw.suffix.lower() != ".png":
        raise PalletLocError(f"--draw {draw}: expected the name of a .png file")
    user = read_pallets(file) if file is not None else {}
    models = find_models(names or {**user, **load_library()}, user)
    parts: list[str | Table] = [_table(models)]
    if names:
        parts += [line for model in models for line in _sources(model)]
    if draw is not None:
        _draw(models, draw)
        parts.append(f"drawn: {draw}")
    return Shown({"pallets": yaml.safe_load(format_pallets(models)), "drawn": draw}, tuple(parts))


def _draw(models: Sequence[PalletModel], path: Path) -> None:
    from palletloc.drawing.pallets import pallets_png  # matplotlib takes longer than all the rest
    from palletloc.io.atomic import write_bytes

    write_bytes(path, pallets_png(models))


def _table(models: Sequence[PalletModel]) -> Table:
    """Return one row for each model, in millimetres."""
    title = f"Front faces: width {_TIMES} height in mm; openings at the level where they begin"
    table = new_table(["name"], ["face"], title=title)
    table.add_column("openings", no_wrap=True)
    table.add_column("edge\nradius", justify="right")
    table.add_column("confirmed")
    table.add_column("from", no_wrap=True, overflow=CUT)
    for model in models:
        table.add_row(
            Text(model.name),
            f"{_millimetres(model.width)} {_TIMES} {_millimetres(model.height)}",
            _summary(model.openings),
            _millimetres(model.edge_radius),
            Text("yes", style="green") if model.confirmed else Text("no", style="yellow"),
            Text(model.source),
        )
    return table


def _summary(openings: Sequence[Opening]) -> str:
    """Return what the openings are like, equal ones together."""
    alike: dict[str, int] = {}
    for opening in openings:
        level = "open" if opening.open_below else f"at {_millimetres(opening.bottom)}"
        size = f"{_millimetres(opening.width)} {_TIMES} {_millimetres(opening.height)} {level}"
        alike[size] = alike.get(size, 0) + 1
    return "\n".join(f"{count} of {size}" for size, count in alike.items())


def _sources(model: PalletModel) -> list[str]:
    """Return where the dimensions come from and what is assumed."""
    texts = {"source": model.source, "note": model.note}
    lines = [f"  {label}: {text}" for label, text in texts.items() if text]
    return [f"{model.name}  {_millimetres(model.depth)} deep", *lines]


def _millimetres(length: float) -> str:
    return f"{round(length * 1000, 1):g}"
