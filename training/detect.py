"""Train a detector of screen photos on simulated ones alone, or score photos with one.

    python training/detect.py train images=DIR weights=resnet18.pth
    python training/detect.py score in=DIR detector=runs/detect/detector.pt

What each does, and its settings: python training/detect.py train --help, and likewise score.
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
        from training.detection import fit

        fit.main(argv[1:])
    elif argv[:1] == ["score"]:
        from training.detection import score

        score.main(argv[1:])
    elif {"-h", "--help"} & set(argv):
        print((__doc__ or "").strip())
    else:
        got = repr(argv[0]) if argv else "nothing"
        raise SystemExit(f"error: training/detect.py takes train or score first; got {got}.")


if __name__ == "__main__":
    main(sys.argv[1:])
