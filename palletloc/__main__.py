"""The program ``palletloc``, also ``python -m palletloc``."""

import sys

from palletloc.cli.app import COMMANDS as OWN_COMMANDS
from palletloc.cli.app import Command, run

COMMANDS = (
    *OWN_COMMANDS,
    Command("calibrate", "calibration.cli:app", "Calibrate the camera's mounting on the forklift; make targets."),
)
"""The commands of all packages, in the order in which help lists them."""


def main() -> None:
    """Run the command line and exit with its code."""
    sys.exit(run(sys.argv[1:], COMMANDS))


if __name__ == "__main__":
    main()
