"""The error that kernels may make, which follows a scene's tolerance."""

from __future__ import annotations

from typing import NamedTuple

from moireaug.scene.record import SceneRecord

# tolerances that budgets follow: below the first, float32 rounds by more; above the second, what
# depends on the grids of nodes hardly gets faster
MIN_TOLERANCE, MAX_TOLERANCE = SceneRecord.tolerance / 64, SceneRecord.tolerance * 8
TRANSFER_MARGIN = 1.2  # by how much a transfer may be higher between samples of it
MAX_MOTION_RANGE = 0.4  # of a wave's cycles per motion, over samples that allow for no more
REFERENCE_AMPLITUDE = 0.3  # of a beat's harmonic, for which `ErrorBudget` states `beat_cycles`


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
    def of(tolerance: float, exactness: float = 1) -> ErrorBudget:
        """Return the budget of a scene of this tolerance.

        What is left out is proportional to the tolerance; the error of a line grows with the square
        of the step between nodes, and that of a cubic with its fourth power.

        exactness: by how much the errors of the pattern alone are smaller.
        """
        error = min(max(tolerance, MIN_TOLERANCE), MAX_TOLERANCE) / SceneRecord.tolerance
        line, cubic = error**0.5, (error / exactness) ** 0.25
        return ErrorBudget(
            harmonic_amplitude=2e-5 * error / exactness,
            beat_amplitude=1e-4 * error / exactness,
            cell_light=1e-3 * error,
            tap_weight=1e-4 * error,
            phase_error=4e-3 * error,
            flat_log_scale=5e-4 * error,
            amplitude_log_scale=0.15 * cubic,
            amplitude_cycles=0.12 * cubic,
            weight_log_scale=0.03 * line,
            weight_motion=0.3 * line,
            beat_cycles=0.2 * cubic,
        )
