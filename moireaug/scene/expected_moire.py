"""About how much moiré the photos of a shot show."""

from __future__ import annotations

import torch

from moireaug.scene.plan import Moire
from moireaug.scene.shot import ShotRecord

# codes of a photo by which a reading's standard deviation of its own mean is seen: about, for the
# presets' tone curves and light; measured 40 to 70
CODES_PER_CONTRAST = 50.0
QUANTILES = 0.1, 0.5, 0.9


@torch.no_grad()
def moire_of(shot: ShotRecord) -> Moire | None:
    """Return the moiré of a shot's photos, from the panel's harmonics in the middle of the image;
    None for full readings, which have no closed form."""
    variance = shot.plan.method.seen_variance(shot)
    if variance is None:
        return None
    codes = CODES_PER_CONTRAST * variance.mean(1).sqrt()
    return Moire(*codes.quantile(codes.new_tensor(QUANTILES)).tolist())
