"""Where a sensor pixel looks: homography, lens distortion, sampling grids and their Jacobians.
Tensors only."""
