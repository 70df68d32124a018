"""Effects that bring a reading outside [0, 1] back, where noise beyond it counts in an attack."""

import pytest
import torch

from moireaug import Scene
from moireaug.camera.pipeline import DEVELOP
from moireaug.common.numeric import clip
from moireaug.scene.by_name import with_values

VALUES = {
    "develop.red": 0.8,
    "develop.blue": 0.8,
    "develop.saturation": 0.7,
    "develop.contrast": 0.2,
    "develop.shoulder": 0.2,
    "develop.brighten": -0.2,
    "sensor.bits": 8,
}
NAMES = [effect.name for effect in DEVELOP]
UNTIL_CLIP = DEVELOP[: NAMES.index("clip")]


@pytest.mark.parametrize("effect", UNTIL_CLIP, ids=lambda effect: effect.name)
def test_a_reading_out_of_range_counts_where_an_effect_mixes_it(effect):
    g = torch.Generator().manual_seed(0)
    shot = with_values(Scene.preset("screen_photo"), VALUES).sample(2, (16, 16), g)
    shape = shot.raw_shape() if effect.name == "demosaic" else (2, 3, 16, 16)
    reading = 2 * torch.rand(shape, generator=g) - 0.5
    beyond, within = clip(effect(reading, shot)), clip(effect(clip(reading), shot))
    counts = not torch.allclose(beyond, within, atol=1e-6)
    assert counts == effect.mixes_readings


def test_no_effect_after_the_clipping_of_codes_mixes_readings():
    assert not any(effect.mixes_readings for effect in DEVELOP[len(UNTIL_CLIP) :])
