"""``python -m benchmarks [RECORDING ...]``: speed, or one of the other measurements that ``--help`` lists."""

from __future__ import annotations

import os
import sys

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""How many threads the libraries below NumPy, SciPy and OpenCV take, read when those are imported."""


def main() -> int:
    """Measure in one thread and return the exit code."""
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    from benchmarks.command import run

    return run(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
