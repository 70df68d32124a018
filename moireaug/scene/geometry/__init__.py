"""Where a sensor pixel looks: homography, lens distortion, sampling grids and their Jacobians.
Tensors; the pose also of NumPy arrays."""
