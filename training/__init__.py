"""Recipes for robust training: `fit.py` trains, `reattack.py` attacks, `frontier.py` compares."""

from moireaug.extras import require

require("train", "training")
