"""The command ``palletloc calibrate plan`` from layout to prediction."""

from __future__ import annotations

import json
from pathlib import Path

from rich import box
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from calibration.degeneracy import NAMES
from calibration.finding_table import finding_line
from calibration.findings import PASS
from calibration.outcome import Outcome, free_stem
from calibration.plan.assessment import Plan, assess_plan
from calibration.plan.file import read_plan
from calibration.plan.report import TARGET_HEADINGS, plan_data, plan_page, sigma_texts, target_cells
from palletloc.io.atomic import write_text


def plan_layout(path: Path, out: Path | None = None) -> Outcome:
    """Predict what a layout of targets will give.

    Parameters
    ----------
    path : Path
        The layout: a file like extrinsics.yaml, or a folder that has one.
    out : Path, optional
        The file for the report, which ends in .html; the same as JSON goes beside it.

    Returns
    -------
    Outcome
        The exit code is the one that a calibration with this layout would have; one that would fail has its
        reports under names that do not exist yet.

    Raises
    ------
    PalletLocError
        If the file is missing or wrong, or a file cannot be written.
    """
    plan = assess_plan(read_plan(path).layout)
    files: tuple[Path, ...] = ()
    if out is not None:
        stem = out.with_suffix("") if plan.exit_code == PASS else free_stem(out)
        files = stem.with_name(stem.name + ".html"), stem.with_name(stem.name + ".json")
        write_text(files[0], plan_page(plan))
        write_text(files[1], json.dumps(plan_data(plan), indent=1, allow_nan=False) + "\n")
    return Outcome(plan.exit_code, tuple(_summary(plan)), files, tuple(finding_line(one) for one in plan.findings))


def _summary(plan: Plan) -> list[RenderableType]:
    if not plan.prediction.sights:
        return []
    targets = Table(box=box.SIMPLE_HEAD)
    for name in TARGET_HEADINGS:
        targets.add_column(name, justify="left" if name == "target" else "right")
    for one in plan.prediction.sights:
        targets.add_row(*(Text(cell) for cell in target_cells(one)))
    if not any(one.found for one in plan.prediction.sights):
        return [targets]
    sigmas = Table(box=box.SIMPLE_HEAD)
    for name in ("", "predicted sigma", *([] if plan.suggestion is None else ["with one more target"])):
        sigmas.add_column(name, justify="right")
    columns = [list(NAMES), sigma_texts(plan.prediction.sigma)]
    if plan.suggestion is not None:
        columns.append(sigma_texts(plan.suggestion.sigma))
    for row in zip(*columns, strict=True):
        sigmas.add_row(*row)
    more = [] if plan.suggestion is None else [Text(f"one more target: {plan.suggestion.words}")]
    return [targets, sigmas, *more]
