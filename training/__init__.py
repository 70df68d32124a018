"""Recipes for robust training: `fit.py` trains, `reattack.py` attacks, `frontier.py` compares."""

import os

# Before torch is loaded: OpenMP's threads wait for work by spinning. A command alone on its cores
# does not notice; of two that share them, each waits for threads that wait, at less than half speed.
os.environ.setdefault("GOMP_SPINCOUNT", "10000")

from moireaug.extras import require

require("train", "training")
