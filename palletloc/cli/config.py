"""The command ``palletloc config``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from palletloc.cli.showing import Shown, shows


@shows
def config(
    file: Annotated[
        Path | None,
        typer.Option("--file", metavar="YAML", help="Your own parameters; the others keep their defaults."),
    ] = None,
) -> Shown:
    """Print every parameter with its default.

    The output is YAML. Put it into a file, change what you like, delete the rest, and give the file to
    palletloc localize --config.
    """
    import yaml

    from palletloc.io.config_file import format_config, read_config

    text = format_config(None if file is None else read_config(file))
    return Shown(yaml.safe_load(text), (text.rstrip("\n"),))
