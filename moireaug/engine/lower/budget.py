"""The error that kernels may make: thresholds, most of which follow a scene's tolerance, and limits
of what kernels take on."""

from __future__ import annotations

from typing import NamedTuple

from moireaug.scene.record import SceneRecord

# tolerances that budgets follow: below the first, float32 rounds by more; above the second, what
# depends on the grids of nodes hardly gets faster
MIN_TOLERANCE, MAX_TOLERANCE = SceneRecord.tolerance / 64, SceneRecord.tolerance * 8

# Limits of what numba's kernels take on; the reference exposes what is beyond them.
MAX_NODES = 65  # of amplitudes and tap weights, along each axis of the photo
MAX_BEAT_NODES = 192  # along each axis of the photo
MAX_BEAT_TERMS = 1024
MAX_PANEL_PIXELS_PER_SENSOR_PIXEL = 16  # up to which building the panel pays off
MAX_SMALL_PANEL_PIXELS = 2**20  # which are never too many
# Limits of memory; with fewer phases than the budget asks for, weights are less exact.
MAX_PHASES = 512
# at a few nodes, as in a frontal view, whose pixels may all lie where a weight has a kink
MAX_PHASES_OF_FEW_NODES = 8192

# Thresholds at any tolerance.
PASSED_CYCLES_PER_BLUR = 0.8  # above this frequency a Gaussian blur passes less than 1e-5
GAUSSIAN_REACH_SIGMAS = 4.5  # beyond it a Gaussian weighs less than 1e-5
UNCLIPPED_SIGMAS = 5.0  # a mean is clipped by noise only if it is this close to a bound
TRANSFER_MARGIN = 1.2  # by how much a transfer may be higher between samples of it
REFERENCE_AMPLITUDE = 0.3  # of a beat's harmonic, for which `ErrorBudget` states `beat_cycles`
MIN_BANDS = 224  # of a photo, if it has the rows; those of a band share their tap weights


class ErrorBudget(NamedTuple):
    """What kernels leave out, and how far apart nodes are that they interpolate between.

    Args:
        harmonic_amplitude: share of full scale; harmonics that are nowhere stronger are left out.
        beat_amplitude: share of full scale; beats of bins that are nowhere stronger are left out.
        cell_light: share of a pixel's light; cells far from it that give less are left out.
        tap_weight: share of a bin's light; outer pixels that nowhere weigh more are left out.
        phase_error: share of a tap weight, interpolated linearly between phases.
        flat_log_scale: change of the logarithm of the view's scale over a photo that is frontal.
        amplitude_log_scale, amplitude_cycles: change of the logarithm of the view's scale, and of
            the highest frequency, in cycles per sensor pixel, from one node of the harmonics'
            amplitudes to the next; between nodes, amplitudes are cubics.
        weight_log_scale, weight_motion: change of the logarithm of the view's scale, and where
            motion changes sign, of motion as a share of the rest of the blur, from one node of tap
            weights to the next; between nodes, weights are linear.
        beat_cycles: change of the frequency of a beat of amplitude `REFERENCE_AMPLITUDE`, in cycles
            per photo pixel, from one node of the beats' amplitudes to the next; between nodes,
            amplitudes are cubics.
    """

    harmonic_amplitude: float
    beat_amplitude: float
    cell_light: float
    tap_weight: float
    phase_error: float
    flat_log_scale: float
    amplitude_log_scale: float
    amplitude_cycles: float
    weight_log_scale: float
    weight_motion: float
    beat_cycles: float

    @staticmethod
    def of(tolerance: float) -> ErrorBudget:
        """Return the budget of a scene of this tolerance.

        What is left out is proportional to the tolerance; the error of a line grows with the square
        of the step between nodes, and that of a cubic with its fourth power.
        """
        error = min(max(tolerance, MIN_TOLERANCE), MAX_TOLERANCE) / SceneRecord.tolerance
        line, cubic = error**0.5, error**0.25
        return ErrorBudget(
            harmonic_amplitude=2e-5 * error,
            beat_amplitude=1e-4 * error,
            cell_light=1e-3 * error,
            tap_weight=1e-4 * error,
            phase_error=4e-3 * error,
            flat_log_scale=5e-4 * error,
            amplitude_log_scale=0.15 * cubic,
            amplitude_cycles=0.12 * cubic,
            weight_log_scale=0.06 * line,
            weight_motion=0.3 * line,
            beat_cycles=0.2 * cubic,
        )
