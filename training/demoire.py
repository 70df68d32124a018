"""Clean photos of screens with a demoiréing network, or train one on simulated pairs alone.

    python training/demoire.py clean in=DIR out=DIR
    python training/demoire.py train data.root=DIR model=esdnet

What each does, and its settings: python training/demoire.py train --help, and likewise clean.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

if __name__ == "__main__":  # search the repository, not this folder: a user has a models.py too
    sys.path[: not sys.flags.safe_path] = [str(Path(__file__).resolve().parents[1])]

# before torch is loaded, as it sets how torch's threads wait
import training  # noqa: F401  # isort: skip
from training.system.messages import prepare_output


def main(argv: Sequence[str]) -> None:
    """Run a command line of either kind.

    Raises:
        SystemExit: the command has failed, or there is none of that name.
    """
    prepare_output()
    if argv[:1] == ["train"]:
        from training.config import commands
        from training.demoireing import fit

        commands.run(fit.main, fit.DemoireConfig, "train")
    elif argv[:1] == ["clean"]:
        from training.demoireing import clean

        clean.main(argv[1:])
    elif {"-h", "--help"} & set(argv):
        print((__doc__ or "").strip())
    else:
        got = repr(argv[0]) if argv else "nothing"
        raise SystemExit(f"error: training/demoire.py takes train or clean first; got {got}.")


if __name__ == "__main__":
    main(sys.argv[1:])
