"""The program ``palletloc``, also ``python -m palletloc``."""

import sys

from palletloc.cli.app import COMMANDS as OWN_COMMANDS
from palletloc.cli.app import Command, run

_DEMO = Command("demo", "tracking.demo:demo", "Localize, track and evaluate the sample that comes along.")
_TRACK = Command("track", "tracking.cli:track", "Follow the pallets of a recording from shot to shot.")
_CONFIG = Command("config", "tracking.cli:config", "Print every parameter with its default.")
_CALIBRATE = Command(
    "calibrate", "calibration.cli:app", "Calibrate the camera's mounting, lenses and shelf plane; make targets."
)


def _with_others() -> tuple[Command, ...]:
    """Return the commands of all packages; a name that stands in two of them means the one that knows more."""
    commands = {command.name: command for command in OWN_COMMANDS}
    names = list(commands)
    names.insert(names.index("localize") + 1, _TRACK.name)
    commands |= {command.name: command for command in (_DEMO, _TRACK, _CONFIG, _CALIBRATE)}
    return tuple(commands[name] for name in (_DEMO.name, *names, _CALIBRATE.name))


COMMANDS = _with_others()
"""The commands of the program, in the order in which help lists them."""


def main() -> None:
    """Run the command line and exit with its code."""
    sys.exit(run(sys.argv[1:], COMMANDS))


if __name__ == "__main__":
    main()
