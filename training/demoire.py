"""Clean photos of screens with a demoiréing network, or train one on simulated pairs alone.

    python training/demoire.py clean in=DIR out=DIR
    python training/demoire.py train data.root=DIR model=esdnet

What each does, and its settings: python training/demoire.py train --help, and likewise clean.
"""

import sys
from functools import partial
from pathlib import Path

if __name__ == "__main__":  # search the repository, not this folder: a user has a models.py too
    sys.path[: not sys.flags.safe_path] = [str(Path(__file__).resolve().parents[1])]

# before torch is loaded, as it sets how torch's threads wait
import training  # noqa: F401  # isort: skip
from training.system.subcommands import run_subcommand

MODULES = {"train": "training.demoireing.fit", "clean": "training.demoireing.clean"}
main = partial(run_subcommand, "training/demoire.py", __doc__, MODULES)


if __name__ == "__main__":
    main(sys.argv[1:])
