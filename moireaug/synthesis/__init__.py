"""Synthesis: pictures, their photos off a screen, and the same photos without moiré, aligned."""

from moireaug.synthesis.pairs import Pair, Pairs
from moireaug.synthesis.twins import without_moire

__all__ = ["Pair", "Pairs", "without_moire"]
