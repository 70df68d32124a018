"""Train a detector of screen photos on simulated and labelled ones, or score photos with one.

    python training/detect.py train images=DIR weights=resnet18.pth
    python training/detect.py score in=DIR detector=runs/detect/detector.pt

What each does, and its settings: python training/detect.py train --help, and likewise score.
"""

import sys
from functools import partial
from pathlib import Path

if __name__ == "__main__":  # search the repository, not this folder: a user has a models.py too
    sys.path[: not sys.flags.safe_path] = [str(Path(__file__).resolve().parents[1])]

# before torch is loaded, as it sets how torch's threads wait
import training  # noqa: F401  # isort: skip
from training.system.subcommands import run_subcommand

MODULES = {"train": "training.detection.fit", "score": "training.detection.score"}
main = partial(run_subcommand, "training/detect.py", __doc__, MODULES)


if __name__ == "__main__":
    main(sys.argv[1:])
