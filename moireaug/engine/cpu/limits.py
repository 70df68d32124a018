"""Limits of what the CPU's kernels take on, and thresholds at any tolerance."""

# Limits of views and panels; the reference exposes what is beyond them.
MAX_NODES = 65  # of amplitudes and tap weights, along each axis of the photo
MAX_STEP = 1e4  # panel pixels from one pixel to the next: a crop may lie beyond the horizon
MAX_BEAT_NODES = 192  # along each axis of the photo
MAX_BEAT_TERMS = 4096
MAX_BEAT_AMPLITUDES = 2**25  # of all terms at all nodes
MAX_FREQUENCY_RANGE = 512.0  # of a harmonic over the photo, cycles per sensor pixel
MAX_PANEL_PIXELS_PER_SENSOR_PIXEL = 16  # up to which building the panel pays off
MAX_SMALL_PANEL_PIXELS = 2**20  # which are never too many
# Limits of memory; with fewer phases than the budget asks for, weights are less exact.
MAX_PHASES = 512
# at a few nodes, as in a frontal view, whose pixels may all lie where a weight has a kink
MAX_PHASES_OF_FEW_NODES = 8192

# Thresholds.
PASSED_CYCLES_PER_BLUR = 0.8  # above this frequency a Gaussian blur passes less than 1e-5
GAUSSIAN_REACH_SIGMAS = 4.5  # beyond it a Gaussian weighs less than 1e-5
UNCLIPPED_SIGMAS = 5.0  # a mean is clipped by noise only if it is this close to a bound
MIN_WEIGHT_BANDS = 224  # of a photo, if it has the rows; those of a band share their tap weights
