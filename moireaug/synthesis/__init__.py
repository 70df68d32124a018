"""Synthesis: pictures, their photos off a screen, and the same photos without moiré, aligned; and
photos of screens in rooms."""

from moireaug.synthesis.pairs import Pair, Pairs
from moireaug.synthesis.rooms import Room, RoomPhotos, screen_in_room
from moireaug.synthesis.twins import without_moire

__all__ = ["Pair", "Pairs", "Room", "RoomPhotos", "screen_in_room", "without_moire"]
