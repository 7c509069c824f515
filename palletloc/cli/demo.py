"""The command ``palletloc demo``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from statistics import median
from typing import Annotated

import numpy as np
import typer
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from palletloc.candidate import ShotView
from palletloc.cli.explain import write_explanation
from palletloc.io.atomic import write_bytes, write_text
from palletloc.io.csv_table import format_number, write_rows
from palletloc.io.measurements import format_time
from palletloc.io.run_folder import Run, RunFolder
from palletloc.io.truth import Truth, read_truth
from palletloc.measurement import PalletMeasurement
from palletloc.offline import Job, Outcome, read_job, work_through
from palletloc.report.comparison import Comparison, PoseError, compare, placed_pallets

ERRORS, PAGE, PICTURES = "errors.csv", "index.html", "pictures"
"""Names of the files and the folder that the demo adds to those of a run."""
ERROR_COLUMNS = (
    *("time_s", "file", "pallet", "model", "range_m", "depth_m", "along_m", "height_m", "yaw_rad"),
    *("sigma_depth_m", "sigma_along_m", "sigma_height_m", "sigma_yaw_rad"),
)
"""Header of errors.csv."""
NEAR = 4.5
"""Range up to which pallets should be found, in metres."""
