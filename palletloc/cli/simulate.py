"""The command ``palletloc simulate``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from palletloc.choices import CameraKind, Illumination, Side
from palletloc.cli.help import RESULTS, SCENE, SENSOR
from palletloc.cli.options import within
from palletloc.cli.showing import Shown, progress, shows
from palletloc.cli.tables import plain_table

if TYPE_CHECKING:
    from palletloc.geometry import Image
    from palletloc.synthetic.simulation import Simulation


@shows
def simulate(
    out: Annotated[
        Path, typer.Option(metavar="DIR", rich_help_panel=RESULTS, help="Folder of the recording: new, or empty.")
    ],
    seed: Annotated[
        int,
        typer.Option(
            rich_help_panel=SCENE, min=0, max=2**63 - 1, help="The same options and seed give the same recording."
        ),
    ] = 0,
    shots: Annotated[
        int, typer.Option(rich_help_panel=SCENE, min=1, max=100_000, help="How many shots along the approach.")
    ] = 12,
    width: Annotated[
        int, typer.Option(rich_help_panel=SENSOR, min=64, max=16384, help="Width of an image, in pixels.")
    ] = 1920,
    model: Annotated[
        list[str] | None,
        typer.Option(
            rich_help_panel=SCENE,
            metavar="NAME",
            help="Pallet model in the rack; may be repeated (epal1-1200 if none).",
        ),
    ] = None,
    side: Annotated[
        Side, typer.Option(rich_help_panel=SCENE, metavar="NAME", help=f"Side of the shelf: {', '.join(Side)}.")
    ] = Side.LEFT,
    camera: Annotated[
        CameraKind,
        typer.Option(rich_help_panel=SENSOR, metavar="NAME", help=f"Kind of camera: {', '.join(CameraKind)}."),
    ] = CameraKind.EQUIRECTANGULAR,
    light: Annotated[
        Illumination,
        typer.Option(rich_help_panel=SCENE, metavar="NAME", help=f"Kind of light: {', '.join(Illumination)}."),
    ] = Illumination.EVEN,
    level: Annotated[
        list[float] | None,
        typer.Option(
            rich_help_panel=SCENE,
            **within(0, 20),
            help="Height that loads stand on, in metres; may be repeated (0 and 1.55 if none).",
        ),
    ] = None,
    blur: Annotated[
        float,
        typer.Option(rich_help_panel=SENSOR, **within(0, 20), help="Blur, in pixels (one sigma)."),
    ] = 0.6,
    noise: Annotated[
        float,
        typer.Option(
            rich_help_panel=SENSOR,
            **within(0, 100),
            help="Noise, in grey levels of 255 (one sigma).",
        ),
    ] = 1.5,
    gain: Annotated[float, typer.Option(rich_help_panel=SENSOR, **within(0.01, 100), help="Exposure.")] = 1.0,
    occluders: Annotated[
        int, typer.Option(rich_help_panel=SCENE, min=0, max=1000, help="Pallets that something stands before.")
    ] = 0,
    gloss: Annotated[
        float,
        typer.Option(rich_help_panel=SCENE, **within(0, 1), help="How much the floor mirrors."),
    ] = 0.0,
) -> Shown:
    """Write a synthetic recording with its truth: an approach to a rack, drawn from a seed."""
    from palletloc.pallet_library import find_models
    from palletloc.synthetic.aisle import AisleSpec
    from palletloc.synthetic.rig import Sensor
    from palletloc.synthetic.simulation import SimulationSpec
    from palletloc.synthetic.simulation import simulate as draw_simulation

    aisle = AisleSpec(
        models=find_models(model or ["epal1-1200"], {}),
        side=side,
        levels=tuple(level) if level else (0.0, 1.55),
        light=light,
        occluders=occluders,
        gloss=gloss,
    )
    sensor = Sensor(blur_px=blur, noise=noise, gain=gain)
    spec = SimulationSpec(aisle=aisle, camera=camera, width=width, shots=shots, sensor=sensor)
    simulation = draw_simulation(spec, seed)
    with progress("Rendering", shots) as advance:
        save_simulation(out, simulation, _counted(simulation.images(), advance))
    document = {
        "recording": out,
        "shots": shots,
        "image": [simulation.camera.width, simulation.camera.height],
        "pallets": len(simulation.aisle.pallets),
        "way_m": simulation.approach.length,
        "duration_s": simulation.approach.duration,
    }
    return Shown(document, (_summary(simulation), f"recording: {out}"))


def save_simulation(folder: Path, simulation: Simulation, images: Iterable[Image] | None = None) -> None:
    """Write a simulation as a recording with its truth, whole or not at all.

    Parameters
    ----------
    folder : Path
        Does not exist yet, or is empty.
    simulation : Simulation
        What to write.
    images : iterable of (height, width, 3) array of uint8, optional
        Its shots, where the caller follows them as they are made.

    Raises
    ------
    OutputError
        If it cannot be written, or the folder has something in it.
    """
    from palletloc.io.recording import Recording, ShotFile, write_recording
    from palletloc.io.truth import TruePallet, Truth

    spec = simulation.spec
    translation, rotation = spec.mounting_translation_sigma, spec.mounting_rotation_sigma
    recording = Recording(
        folder=folder,
        camera=simulation.camera,
        forklift_from_camera=simulation.recorded_mounting,
        shelf=simulation.shelf,
        models=spec.aisle.models,
        shots=tuple(ShotFile(float(time), f"images/{index:06d}.jpg") for index, time in enumerate(simulation.times)),
        odometry=simulation.odometry,
        translation_sigma=(translation,) * 3 if translation else None,
        rotation_sigma=(rotation,) * 3 if rotation else None,
    )
    pallets = tuple(TruePallet(p.name, p.model.name, p.world_from_pallet) for p in simulation.aisle.pallets)
    shots = simulation.images() if images is None else images
    write_recording(folder, recording, shots, Truth(simulation.truth, pallets))


def _counted(images: Iterable[Image], advance: Callable[[], None]) -> Iterator[Image]:
    """Return the images, and tell of each that is made."""
    for image in images:
        yield image
        advance()


def _summary(simulation: Simulation) -> Table:
    table = plain_table()
    table.add_row("shots", str(simulation.spec.shots))
    table.add_row("image", f"{simulation.camera.width} x {simulation.camera.height}")
    table.add_row("pallets", str(len(simulation.aisle.pallets)))
    table.add_row("way", f"{simulation.approach.length:.1f} m in {simulation.approach.duration:.1f} s")
    return table
