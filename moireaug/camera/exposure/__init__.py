"""Panel light integrated over the aperture and point spread of each sensor pixel: one class
per method."""
