"""`python -m motionkit`: the command line, as torchrun and interpreters without the installed script start it."""

import sys
from pathlib import Path


def look_here_last() -> None:
    """Put the current folder, which `python -m` looks into first, behind what is installed.

    A repository that lies there may have a package of the name of one of ours, which it would hide.
    """
    if not sys.flags.safe_path and Path(sys.path[0]) != Path(__file__).parents[1]:
        sys.path.append(sys.path.pop(0))


if __name__ == "__main__":
    look_here_last()
    from motionkit.cli.app import main

    main()
