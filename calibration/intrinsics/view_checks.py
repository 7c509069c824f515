"""What there is to say about shots before anything is fitted: twins, shots without a board, too few of them."""

from __future__ import annotations

from calibration.findings import Finding, Severity
from calibration.intrinsics.board_views import Collected
from calibration.intrinsics.task import IntrinsicsTask

FEWEST_VIEWS = 3
"""Fewer boards give no lens."""


def view_findings(task: IntrinsicsTask, found: Collected) -> list[Finding]:
    """Return what there is to say about the shots before anything is fitted.

    Parameters
    ----------
    task : IntrinsicsTask
        What was to be read.
    found : Collected
        What the shots show.
    """
    findings = [
        Finding(Severity.WARNING, "duplicate_view", f"{twin} is the same as {earlier}; it counts once", "take it out")
        for twin, earlier in found.duplicates
    ]
    findings += [
        Finding(Severity.WARNING, "no_board", f"{shot} shows no whole board", "take it out or again")
        for shot in found.empty
    ]
    for lens in range(task.lenses):
        count = sum(view.lens == lens for view in found.views)
        if count < FEWEST_VIEWS:
            what = f"lens {lens}: {count} boards are seen; a lens needs {FEWEST_VIEWS} at least, better 15"
            how = "take more shots, and check the numbers of the boards in intrinsics.yaml"
            findings.append(Finding(Severity.DEGENERATE, "few_views", what, how))
    return findings
