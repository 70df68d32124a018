"""Registration: the photo back in the image's frame."""

import dataclasses

import pytest
import torch
import torch.nn.functional as F

from moireaug import Develop, Lens, Panel, Scene, Sensor, View
from moireaug.camera.effects.resize import Register


@pytest.mark.parametrize(("dx", "dy"), [(0, 0), (2, 0), (-1, 1), (0, -3)])
def test_whole_pixels_move_whole_and_the_unseen_is_black(dx, dy):
    photo = torch.rand(1, 3, 5, 6, dtype=torch.float64)
    shot = Scene(view=View(shift_x=dx / 6, shift_y=dy / 5)).sample(1, (5, 6))
    out = Register()(photo, shot)
    for y in range(5):
        for x in range(6):
            seen = 0 <= x + dx < 6 and 0 <= y + dy < 5
            wanted = photo[0, :, y + dy, x + dx] if seen else torch.zeros(3).double()
            assert torch.allclose(out[0, :, y, x], wanted, atol=1e-12)


def test_a_registered_photo_lies_on_its_image():
    coarse = torch.rand(1, 3, 4, 5, dtype=torch.float64)
    blobs = F.interpolate(coarse, size=(32, 40), mode="bicubic").clamp(0, 1)
    sensor, view = Sensor(cfa="none", scale=2.0), View(yaw=15, roll=-10, zoom=0.9)
    scene = Scene(panel=Panel(layout="even"), view=view, lens=Lens(k1=0.05), sensor=sensor)
    off = (scene.capture(blobs) - blobs).abs()[..., 3:-3, 3:-3]
    assert off.mean() < 0.01
    astray = dataclasses.replace(scene, develop=Develop(registered=False))
    assert (astray.capture(blobs) - blobs).abs()[..., 3:-3, 3:-3].mean() > 0.05
