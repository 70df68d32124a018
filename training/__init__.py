"""Recipes for robust training: `fit.py` trains, `reattack.py` attacks, `frontier.py` compares."""

import os

# Before torch is loaded: OpenMP's threads wait for work by spinning, on the cores that the engine's
# threads need. Spinning for less makes a step of moire_at a fifth faster on two cores, and one of
# plain training no slower.
os.environ.setdefault("GOMP_SPINCOUNT", "10000")

from moireaug.extras import require

require("train", "training")
