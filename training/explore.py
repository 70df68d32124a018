"""Open the explorer in a browser.

    python training/explore.py

It listens on 127.0.0.1 only and sends nothing anywhere else.
"""

import sys
from pathlib import Path

if __name__ == "__main__":  # search the repository, not this folder: a user has a models.py too
    sys.path[: not sys.flags.safe_path] = [str(Path(__file__).resolve().parents[1])]

import argparse
from collections.abc import Sequence

from moireaug.common.extras import require
from training.system.messages import prepare_output


def main(argv: Sequence[str] | None = None) -> None:
    """Read the command line and serve the page until Ctrl-C.

    Raises:
        SystemExit: the extra is not installed (the message says how to install it), or the port is
            taken.
    """
    prepare_output()
    parser = argparse.ArgumentParser(prog="python training/explore.py", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--port", type=port, help="default: 7860 or the next free one")
    parser.add_argument("--quiet", action="store_true", help="do not open a browser")
    args = parser.parse_args(argv)
    try:
        require("explore", "training/explore.py")
    except ModuleNotFoundError as error:
        raise SystemExit(f"error: {error}") from None

    from training.explorer import page

    try:
        page.serve(args.port, in_browser=not args.quiet)
    except OSError as error:
        raise SystemExit(f"error: {error}") from None


def port(text: str) -> int:
    """Return the number of a port.

    Raises:
        argparse.ArgumentTypeError: it is no number from 1 to 65535.
    """
    if not text.isdecimal() or not 1 <= int(text) <= 65535:
        raise argparse.ArgumentTypeError(f"a port is a number from 1 to 65535; got {text!r}")
    return int(text)


if __name__ == "__main__":
    main()
