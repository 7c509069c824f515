"""The commands ``palletloc calibrate ...``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palletloc.cli import options
from palletloc.cli.help import BOARD, FLAG, INPUT, MEASURING, RESULTS, TAGS, PlainCommand, PlainGroup, examples
from palletloc.cli.options import within
from palletloc.cli.showing import Shown, shows, working
from palletloc.errors import PalletLocError

if TYPE_CHECKING:
    from calibration.result_page import ResultPage


_Yaml = Annotated[
    Path,
    typer.Option("--out", rich_help_panel=RESULTS, metavar="YAML", help="File to write; reports go beside it."),
]
"""The file that a calibration gives."""
_Report = Annotated[
    Path | None,
    typer.Option("--out", rich_help_panel=RESULTS, metavar="HTML", help="File for the report; JSON goes beside it."),
]
"""Where a command that changes nothing writes a report."""


@shows
def extrinsics(
    out: _Yaml,
    folder: Annotated[
        Path | None, typer.Argument(metavar="[FOLDER]", help="With extrinsics.yaml and its shots.")
    ] = None,
    motion: Annotated[
        Path | None,
        typer.Option(
            rich_help_panel=INPUT,
            metavar="RECORDING",
            help="Instead of FOLDER: a drive past targets, with targets.yaml.",
        ),
    ] = None,
    columns: options.SurveyColumns = None,
) -> Shown:
    """Find the camera's pose on the forklift from surveyed targets; or check it by a drive past targets."""
    from calibration.motion.assessment import calibrate_motion  # numpy, cv2 and matplotlib take a second
    from calibration.motion.report import motion_page
    from calibration.mounting.assessment import calibrate_mounting
    from calibration.mounting.report import mounting_page
    from calibration.result_page import write_result
    from palletloc.survey.plan import split_columns

    _expect(out, ".yaml", ".yml")
    with working("reading") as told:
        if folder is not None and motion is None:
            page = mounting_page(calibrate_mounting(folder, told, split_columns(columns)))
        elif motion is not None and folder is None:
            page = motion_page(calibrate_motion(motion, told))
        else:
            raise typer.BadParameter("expected one of FOLDER and --motion RECORDING")
        told("writing the report")
        files = write_result(page, out)
    return _shown(page, files)


@shows
def plan(
    layout: Annotated[Path, typer.Argument(metavar="LAYOUT", help="A file like extrinsics.yaml, or its folder.")],
    out: _Report = None,
) -> Shown:
    """Predict how well planned targets will give the camera's pose, before anything is hung or driven."""
    from calibration.plan.assessment import plan_targets
    from calibration.plan.report import plan_page
    from calibration.result_page import write_result

    if out is not None:
        _expect(out, ".html")
    page = plan_page(plan_targets(layout))
    return _shown(page, () if out is None else write_result(page, out))


@shows
def shelf(
    recording: options.RecordingFolder,
    out: _Yaml,
    side: Annotated[
        str | None,
        typer.Option(rich_help_panel=INPUT, help="Side of the shelf in the direction of travel: left, right."),
    ] = None,
    distance: Annotated[
        float | None, typer.Option(rich_help_panel=INPUT, help="About how far it is from the camera, in metres.")
    ] = None,
    front: Annotated[
        str,
        typer.Option(
            rich_help_panel=MEASURING, help="What the front is: uprights (their faces) or pallets (theirs)."
        ),
    ] = "uprights",
    tag_size: Annotated[
        float | None,
        typer.Option(
            rich_help_panel=TAGS,
            **within(0.01, 10),
            help="Side of tags on the uprights, in metres.",
        ),
    ] = None,
    tag_dictionary: Annotated[
        str, typer.Option(rich_help_panel=TAGS, help="Of these tags, as OpenCV names it.")
    ] = "DICT_APRILTAG_36h11",
    tag_offset: Annotated[
        float,
        typer.Option(
            rich_help_panel=TAGS,
            **within(-1, 1),
            help="How far their faces lie before the front, in metres.",
        ),
    ] = 0.0,
) -> Shown:
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
    with working("reading") as told:
        page = shelf_page(calibrate_shelf(recording, side, distance, Front(front), tags, told))
        told("writing the report")
        files = write_result(page, out)
    return _shown(page, files)


@shows
def check(
    recording: options.RecordingFolder,
    out: _Report = None,
    tolerance: Annotated[
        float,
        typer.Option(
            rich_help_panel=MEASURING,
            **within(0.01, 5),
            help="How far the camera may be turned about x or y, in degrees.",
        ),
    ] = 0.15,
) -> Shown:
    """Check whether the camera still sits on the forklift as a recording says."""
    from calibration.check.assessment import check_mounting
    from calibration.check.report import check_page
    from calibration.result_page import write_report

    if out is not None:
        _expect(out, ".html")
    with working("reading") as told:
        page = check_page(check_mounting(recording, tolerance, told))
    return _shown(page, () if out is None else write_report(page, out))


def _expect(out: Path, *suffixes: str) -> None:
    """Refuse a name that does not end as what is written."""
    if out.suffix.lower() not in suffixes:
        raise PalletLocError(f"--out {out}: expected the name of a {suffixes[0]} file")


def _shown(page: ResultPage, files: Sequence[Path]) -> Shown:
    """Return a result and what was written, with its exit code."""
    from calibration.result_page import json_values, reason_lines, terminal_parts

    parts = (*terminal_parts(page), page.verdict, *(f"written: {path}" for path in files))
    document = {**json_values(page), "judgement": str(page.judgement), "verdict": page.verdict, "written": files}
    return Shown(document, parts, reason_lines(page), page.exit_code)


@shows
def board(
    out: Annotated[Path, typer.Option(rich_help_panel=RESULTS, metavar="PDF", help="File to write.")],
    columns: Annotated[int, typer.Option(rich_help_panel=BOARD, min=2, max=100, help="Squares side by side.")] = 7,
    rows: Annotated[
        int, typer.Option(rich_help_panel=BOARD, min=2, max=100, help="Squares one above the other.")
    ] = 5,
    square: Annotated[
        float,
        typer.Option(
            rich_help_panel=BOARD,
            **within(1, 10_000),
            help="Side of a square, in millimetres.",
        ),
    ] = 100.0,
    marker: Annotated[
        float,
        typer.Option(
            rich_help_panel=BOARD,
            **within(1, 10_000),
            help="Side of a marker, in millimetres.",
        ),
    ] = 75.0,
    dictionary: Annotated[
        str, typer.Option(rich_help_panel=BOARD, help="Of the markers, as OpenCV names it.")
    ] = "DICT_4X4_250",
    first: Annotated[int, typer.Option(rich_help_panel=BOARD, min=0, help="Id of the marker at the upper left.")] = 0,
    tag: Annotated[
        bool, typer.Option("--tag", rich_help_panel=BOARD, metavar=FLAG, help="A single marker instead of a board.")
    ] = False,
) -> Shown:
    """Make a printable board or tag at true scale, with a ruler to check the print."""
    import yaml

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
    content = target_yaml(target).rstrip("\n")
    document = {"written": [out], "target": yaml.safe_load(content)}
    return Shown(document, (f"written: {out}", f"for extrinsics.yaml:\n{content}"))


@shows
def intrinsics(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="With intrinsics.yaml, and shots or corners.")],
    out: _Yaml,
    model: Annotated[
        str,
        typer.Option(
            rich_help_panel=MEASURING,
            help="kannala_brandt, mei, double_sphere, eucm, pinhole, rational_pinhole, stitched_equirectangular.",
        ),
    ] = "kannala_brandt",
) -> Shown:
    """Find the parameters of a lens, or of two, from shots of boards."""
    from calibration.intrinsics.fit import calibrate_lenses
    from calibration.intrinsics.report import lenses_page
    from calibration.result_page import write_result

    _expect(out, ".yaml", ".yml")
    with working("reading") as told:
        page = lenses_page(calibrate_lenses(folder, model, told))
        told("writing the report")
        files = write_result(page, out)
    return _shown(page, files)


@shows
def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="Camera file of any program.")],
    to: Annotated[
        str,
        typer.Option(
            rich_help_panel=RESULTS, metavar="FORMAT[/MODEL]", help="palletloc, kalibr, basalt, ros, opencv or ocam."
        ),
    ],
    out: Annotated[Path, typer.Option(rich_help_panel=RESULTS, metavar="FILE", help="File to write.")],
    camera: Annotated[
        int | None, typer.Option(rich_help_panel=INPUT, help="Which camera of several, from 0 on.")
    ] = None,
    max_angle_deg: Annotated[
        float,
        typer.Option(
            rich_help_panel=MEASURING,
            **within(1.0, 180.0),
            help="How far off axis counts.",
        ),
    ] = 180.0,
) -> Shown:
    """Convert a camera file to the form of another program, or to another lens model."""
    from math import degrees, radians

    from calibration.formats.convert import convert_camera

    done = convert_camera(source, to, out, camera, radians(max_angle_deg))
    parts, remarks, differences = [f"{done.source} -> {done.target}"], [f"note: {note}" for note in done.notes], []
    for name, left in zip(done.names, done.differences, strict=False):
        line = f"{name}: {left.rms:.3g} px rms, {left.largest:.3g} px at most"
        parts.append(f"{line}, up to {degrees(left.max_angle):.1f} degrees off axis")
        values = {"rms_px": left.rms, "largest_px": left.largest, "max_angle_deg": degrees(left.max_angle)}
        differences.append({"name": name, **values, "lost": left.unseen})
        if left.unseen > 0:
            remarks.append(f"warning: {name}: {left.unseen:.1%} of its field is lost")
    document = {
        "source": done.source,
        "target": done.target,
        "cameras": differences,
        "notes": list(done.notes),
        "written": [out],
    }
    return Shown(document, (*parts, f"written: {out}"), tuple(remarks))


app = typer.Typer(
    cls=PlainGroup,
    no_args_is_help=True,
    help="Calibrate the camera's mounting, lenses and shelf plane; make targets.",
    epilog=examples(
        (
            "palletloc calibrate board --out board.pdf",
            "palletloc calibrate extrinsics FOLDER --out rig.yaml",
            "palletloc calibrate COMMAND --help       # options and examples of one command",
        )
    ),
)
_COMMANDS: dict[Callable[..., None], tuple[str, ...]] = {
    extrinsics: ("FOLDER --out rig.yaml", "--motion RECORDING --out rig.yaml"),
    plan: ("LAYOUT", "LAYOUT --out plan.html"),
    shelf: ("RECORDING --out new.yaml", "RECORDING --out new.yaml --side left --distance 1.9"),
    check: ("RECORDING", "RECORDING --out check.html"),
    board: ("--out board.pdf", "--out tag.pdf --tag --dictionary DICT_APRILTAG_36h11"),
    intrinsics: ("FOLDER --out camera.yaml", "FOLDER --out camera.yaml --model double_sphere"),
    convert: ("camera.yaml --to ros --out info.yaml", "camera.yaml --to kalibr/double_sphere --out camchain.yaml"),
}
"""The commands with what follows their names in examples, in the order in which help lists them."""
for _command, _lines in _COMMANDS.items():
    _shown_lines = [f"palletloc calibrate {_command.__name__} {line}" for line in _lines]
    app.command(_command.__name__, cls=PlainCommand, epilog=examples(_shown_lines))(_command)
