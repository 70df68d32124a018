"""What stands in front of the camera: the five parts, the Scene that holds them, and the Shot drawn
from it."""
