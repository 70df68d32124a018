"""The light that a panel emits: the Fourier series of its unit cell, and where its subpixels
are."""
