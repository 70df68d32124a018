"""The physical steps between a screen and a photo, one small pure function each. Effects know tensors only."""
