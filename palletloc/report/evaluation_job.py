"""One of many recordings, evaluated with its report."""

from __future__ import annotations

from palletloc.evaluation.batch import BatchJob, BatchResult, evaluate_job
from palletloc.evaluation.recording import EvaluatedRecording
from palletloc.report.evaluation_page import REPORT, evaluation_page


def report_job(job: BatchJob, *, with_pictures: bool = True) -> BatchResult:
    """Evaluate one recording and write its metrics.json, errors.csv and report.html.

    Parameters
    ----------
    job : BatchJob
        What to do.
    with_pictures : bool
        Whether the report shows the images and stages of the worst shots.

    Returns
    -------
    BatchResult
        With the problem of a recording that cannot be evaluated; what an earlier call wrote for it is removed.
    """

    def draw(evaluated: EvaluatedRecording) -> dict[str, str]:
        return {REPORT: evaluation_page(evaluated, with_pictures=with_pictures)}

    result = evaluate_job(job, draw)
    if result.problem:
        (job.out / REPORT).unlink(missing_ok=True)
    return result
