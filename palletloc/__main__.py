"""The program ``palletloc``, also ``python -m palletloc``."""

import sys

from palletloc.cli.app import COMMANDS as OWN_COMMANDS
from palletloc.cli.app import Command, run

_OTHERS = (
    Command(
        "demo",
        "tracking.cli:demo",
        "Localize, track and evaluate the sample that comes along.",
        ("palletloc demo", "palletloc demo --out DIR"),
    ),
    Command(
        "track",
        "tracking.cli:track",
        "Follow the pallets of a recording from shot to shot.",
        (
            "palletloc track RECORDING --out RUN --smooth",
            "palletloc track RECORDING --out DIR --measurements RUN/measurements.csv",
        ),
    ),
    Command(
        "config",
        "tracking.cli:config",
        "Print every parameter with its default.",
        ("palletloc config > mine.yaml", "palletloc config --file mine.yaml   # checks it, too"),
    ),
    Command(
        "calibrate", "calibration.cli:app", "Calibrate the camera's mounting, lenses and shelf plane; make targets."
    ),
)
"""The commands of the other packages; one that stands in two means the one that knows more."""
_ORDER = ("demo", "localize", "track", "evaluate", "explain", "simulate", "pallets", "config", "calibrate")
"""In which help lists the commands."""

COMMANDS = tuple(next(command for command in (*_OTHERS, *OWN_COMMANDS) if command.name == name) for name in _ORDER)
"""The commands of the program."""


def main() -> None:
    """Run the command line and exit with its code."""
    sys.exit(run(sys.argv[1:], COMMANDS))


if __name__ == "__main__":
    main()
