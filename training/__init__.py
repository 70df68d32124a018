"""The commands: `fit.py` trains classifiers, `reattack.py` attacks and `frontier.py` compares them;
`demoire.py` trains networks that remove moiré, and cleans photos; `detect.py` finds photos of
screens; `synthesise.py` makes pairs, and `calibrate.py` fits a scene to real photos.

What a user can mend is raised everywhere as a ValueError or TypeError, before time is spent if it
can be; its message is the sentence that the commands print. Docstrings name other errors alone.
"""

import gc
import os
import sys
from pathlib import Path

# not a notebook or another program, whose process is its own
IS_COMMAND = Path(sys.argv[0]).resolve().parent == Path(__file__).resolve().parent

# Before torch is loaded: OpenMP's threads wait for work by spinning. A command alone on its cores
# does not notice, but two that share them keep each other waiting: each takes twice as long.
if IS_COMMAND:
    os.environ.setdefault("GOMP_SPINCOUNT", "10000")

from moireaug.common.extras import drop_missing_backend, require  # noqa: E402  # which loads torch

require("train", "training")
drop_missing_backend()

# What torch made stays: a command starts and ends a second sooner where collections pass over it.
if IS_COMMAND:
    gc.freeze()
