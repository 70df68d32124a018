"""Layers for networks that must work through a photo of a screen."""

from moireaug.nn.screen_camera import ScreenCamera, ScreenDraw

__all__ = ["ScreenCamera", "ScreenDraw"]
