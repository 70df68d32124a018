"""Recipes for robust training, and the re-attack of what was trained: `fit.py`, `reattack.py` and `frontier.py`."""

from moireaug.extras import require

require("train", "training")
