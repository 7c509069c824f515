"""The commands ``palletloc calibrate ...``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer
from rich.console import Console
from rich.text import Text

from palletloc.errors import PalletLocError

if TYPE_CHECKING:
    from calibration.result_page import ResultPage

app = typer.Typer(no_args_is_help=True, help="Calibrate the camera's mounting, lenses and shelf plane; make targets.")


@app.command("extrinsics")
def extrinsics(
    out: Annotated[Path, typer.Option(metavar="YAML", help="File for camera and mounting; reports go beside it.")],
    folder: Annotated[
        Path | None, typer.Argument(metavar="[FOLDER]", help="With extrinsics.yaml and its shots.")
    ] = None,
    motion: Annotated[
        Path | None,
        typer.Option(metavar="RECORDING", help="Instead of FOLDER: a drive past targets, with targets.yaml."),
    ] = None,
) -> None:
    """Find the camera's pose on the forklift from surveyed targets; or check it by a drive past targets."""
    from calibration.motion.assessment import calibrate_motion  # numpy, cv2 and matplotlib take a second
    from calibration.motion.report import motion_page
    from calibration.mounting.assessment import calibrate_mounting
    from calibration.mounting.report import mounting_page
    from calibration.result_page import write_result

    _expect(out, ".yaml", ".yml")
    with _progress() as told:
        if folder is not None and motion is None:
            page = mounting_page(calibrate_mounting(folder, told))
        elif motion is not None and folder is None:
            page = motion_page(calibrate_motion(motion, told))
        else:
            raise typer.BadParameter("expected one of FOLDER and --motion RECORDING")
        told("writing the report")
        files = write_result(page, out)
    _finish(page, files)


@app.command("plan")
def plan(
    layout: Annotated[Path, typer.Argument(metavar="LAYOUT", help="A file like extrinsics.yaml, or its folder.")],
    out: Annotated[
        Path | None, typer.Option(metavar="HTML", help="File for the report; JSON goes beside it.")
    ] = None,
) -> None:
    """Predict how well planned targets will give the camera's pose, before anything is hung or driven."""
    from calibration.plan.assessment import plan_targets
    from calibration.plan.report import plan_page
    from calibration.result_page import write_result

    if out is not None:
        _expect(out, ".html")
    page = plan_page(plan_targets(layout))
    _finish(page, () if out is None else write_result(page, out))


@app.command("shelf")
def shelf(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="An approach along the shelf.")],
    out: Annotated[Path, typer.Option(metavar="YAML", help="The recording.yaml to write; reports go beside it.")],
    side: Annotated[
        str | None, typer.Option(help="Side of the shelf in the direction of travel: left, right.")
    ] = None,
    distance: Annotated[float | None, typer.Option(help="About how far it is from the camera, in metres.")] = None,
    front: Annotated[
        str, typer.Option(help="What the front is: uprights (their faces) or pallets (theirs).")
    ] = "uprights",
    tag_size: Annotated[float | None, typer.Option(min=0.01, help="Side of tags on the uprights, in metres.")] = None,
    tag_dictionary: Annotated[str, typer.Option(help="Of these tags, as OpenCV names it.")] = "DICT_APRILTAG_36h11",
    tag_offset: Annotated[float, typer.Option(help="How far their faces lie before the front, in metres.")] = 0.0,
) -> None:
    """Find the front plane of a shelf from a recording; by default around the plane that it states."""
    from calibration.result_page import write_result
    from calibration.shelf.assessment import calibrate_shelf
    from calibration.shelf.report import shelf_page
    from calibration.shelf.survey import Front
    from calibration.shelf.upright_tags import TagsOnUprights

    if front not in [known.value for known in Front]:
        raise typer.BadParameter(f"--front {front}: expected uprights or pallets")
    if side not in (None, "left", "right"):
        raise typer.BadParameter(f"--side {side}: expected left or right")
    _expect(out, ".yaml", ".yml")
    if (side is None) != (distance is None):
        raise typer.BadParameter("--side and --distance go together")
    tags = None if tag_size is None else TagsOnUprights(tag_dictionary, tag_size, tag_offset)
    with _progress() as told:
        page = shelf_page(calibrate_shelf(recording, side, distance, Front(front), tags, told))
        told("writing the report")
        files = write_result(page, out)
    _finish(page, files)


@app.command("check")
def check(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="An approach along the shelf.")],
    out: Annotated[
        Path | None, typer.Option(metavar="HTML", help="File for the report; JSON goes beside it.")
    ] = None,
    tolerance: Annotated[
        float, typer.Option(min=0.01, max=5, help="How far the camera may be turned about x or y, in degrees.")
    ] = 0.15,
) -> None:
    """Check whether the camera still sits on the forklift as a recording says."""
    from calibration.check.assessment import check_mounting
    from calibration.check.report import check_page
    from calibration.result_page import write_report

    if out is not None:
        _expect(out, ".html")
    with _progress() as told:
        page = check_page(check_mounting(recording, tolerance, told))
    _finish(page, () if out is None else write_report(page, out))


def _expect(out: Path, *suffixes: str) -> None:
    """Refuse a name that does not end as what is written."""
    if out.suffix.lower() not in suffixes:
        raise PalletLocError(f"--out {out}: expected the name of a {suffixes[0]} file")


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """Show what a run is at, where somebody looks on."""
    console = Console(stderr=True)
    with console.status("reading") as status:
        yield status.update if console.is_terminal else lambda _: None


def _finish(page: ResultPage, files: Sequence[Path]) -> NoReturn:
    """Print a result and what was written, and end with its exit code."""
    from calibration.result_page import reason_lines, terminal_parts

    console = Console()
    for part in terminal_parts(page):
        console.print(part)
    for path in files:
        console.print(Text(f"written: {path}"), soft_wrap=True)
    for line in reason_lines(page):
        typer.echo(f"palletloc: {line}", err=True)
    raise typer.Exit(page.exit_code)


@app.command("board")
def board(
    out: Annotated[Path, typer.Option(metavar="PDF", help="File to write.")],
    columns: Annotated[int, typer.Option(min=2, help="Squares side by side.")] = 7,
    rows: Annotated[int, typer.Option(min=2, help="Squares one above the other.")] = 5,
    square: Annotated[float, typer.Option(min=1, help="Side of a square, in millimetres.")] = 100.0,
    marker: Annotated[float, typer.Option(min=1, help="Side of a marker, in millimetres.")] = 75.0,
    dictionary: Annotated[str, typer.Option(help="Of the markers, as OpenCV names it.")] = "DICT_4X4_250",
    first: Annotated[int, typer.Option(min=0, help="Id of the marker at the upper left.")] = 0,
    tag: Annotated[bool, typer.Option("--tag", help="A single marker instead of a board.")] = False,
) -> None:
    """Make a printable board or tag at true scale, with a ruler to check the print."""
    from calibration.targets.board_pdf import board_pdf, target_yaml
    from calibration.targets.targets import CharucoBoard, SingleTag
    from palletloc.io.atomic import write_bytes

    _expect(out, ".pdf")
    target = (
        SingleTag(marker / 1000, dictionary, first)
        if tag
        else CharucoBoard(columns, rows, square / 1000, marker / 1000, dictionary, first)
    )
    write_bytes(out, board_pdf(target))
    console = Console()
    console.print(Text(f"written: {out}"), soft_wrap=True)
    console.print(Text("for extrinsics.yaml:\n" + target_yaml(target)), soft_wrap=True)


@app.command("intrinsics")
def intrinsics(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="With intrinsics.yaml, and shots or corners.")],
    out: Annotated[Path, typer.Option(metavar="YAML", help="File for the camera; reports go beside it.")],
    model: Annotated[
        str,
        typer.Option(
            help="kannala_brandt, mei, double_sphere, eucm, [rational_]pinhole or stitched_equirectangular."
        ),
    ] = "kannala_brandt",
) -> None:
    """Find the parameters of a lens, or of two, from shots of boards."""
    from calibration.intrinsics.fit import calibrate_lenses
    from calibration.intrinsics.report import lenses_page
    from calibration.result_page import write_result

    _expect(out, ".yaml", ".yml")
    with _progress() as told:
        page = lenses_page(calibrate_lenses(folder, model, told))
        told("writing the report")
        files = write_result(page, out)
    _finish(page, files)


@app.command("convert")
def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="Camera file of any program.")],
    to: Annotated[
        str, typer.Option(metavar="FORMAT[/MODEL]", help="palletloc, kalibr, basalt, ros, opencv or ocam.")
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="File to write.")],
    camera: Annotated[int | None, typer.Option(help="Which camera of several, from 0 on.")] = None,
    max_angle_deg: Annotated[float, typer.Option(min=1.0, max=180.0, help="How far off axis counts.")] = 180.0,
) -> None:
    """Convert a camera file to the form of another program, or to another lens model."""
    from math import degrees, radians

    from calibration.formats.convert import convert_camera

    done = convert_camera(source, to, out, camera, radians(max_angle_deg))
    console = Console()
    console.print(Text(f"{done.source} -> {done.target}"))
    for note in done.notes:
        typer.echo(f"palletloc: note: {note}", err=True)
    for name, left in zip(done.names, done.differences, strict=False):
        line = f"{name}: {left.rms:.3g} px rms, {left.largest:.3g} px at most"
        console.print(Text(f"{line}, up to {degrees(left.max_angle):.1f} degrees off axis"), soft_wrap=True)
        if left.unseen > 0:
            typer.echo(f"palletloc: warning: {name}: {left.unseen:.1%} of its field is lost", err=True)
    console.print(Text(f"written: {out}"), soft_wrap=True)
