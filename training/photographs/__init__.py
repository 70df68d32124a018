"""Real photographs of screens: brought to the frame of the picture that they show, and measured."""
