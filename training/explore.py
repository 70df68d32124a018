"""Open the explorer in a browser.

    python training/explore.py
    python training/explore.py port=7999 browser=false

It listens on 127.0.0.1 only and sends nothing anywhere else.
"""

import sys
from pathlib import Path

if __name__ == "__main__":  # search the repository, not this folder: a user has a models.py too
    sys.path[: not sys.flags.safe_path] = [str(Path(__file__).resolve().parents[1])]

# before torch is loaded, as it sets how torch's threads wait
import training  # noqa: F401  # isort: skip
from collections.abc import Sequence
from dataclasses import dataclass

from moireaug.common.extras import require
from training.config.commands import parse, report_errors
from training.config.settings import setting


@dataclass
class Config:
    """All settings of the command."""

    port: int | None = setting(None, "null: 7860 or the next free one", bounds=(1, 65535))
    browser: bool = setting(True, "whether to open one")


def main(argv: Sequence[str]) -> None:
    """Serve the page until Ctrl-C, or exit with a one-line error: the extra is not installed (the
    message says how to install it), or the port is taken."""
    with report_errors("The explorer is closed."):
        cfg = parse(argv, Config, "python training/explore.py port=7999", __doc__)
        try:
            require("explore", "training/explore.py")
        except ModuleNotFoundError as error:
            raise ValueError(str(error)) from None
        from training.explorer import page

        page.serve(cfg.port, in_browser=cfg.browser)


if __name__ == "__main__":
    main(sys.argv[1:])
