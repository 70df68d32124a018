"""Recipes for robust training: `fit.py` trains, `reattack.py` attacks, `frontier.py` compares.

What a user can mend is raised everywhere as a ValueError or TypeError, before time is spent if it
can be; its message is the sentence that the commands print. Docstrings name other errors alone.
"""

import gc
import os

# Before torch is loaded: OpenMP's threads wait for work by spinning. A command alone on its cores
# does not notice, but two that share them keep each other waiting: each takes twice as long.
os.environ.setdefault("GOMP_SPINCOUNT", "10000")

from moireaug.common.extras import drop_missing_backend, require

require("train", "training")
drop_missing_backend()

# What torch made stays: a command starts and ends a second sooner where collections pass over it.
gc.freeze()
