"""Flicker: the closed form against the light of every moment, summed."""

import itertools
import math

import pytest
import torch

from moireaug import Scene, expose
from moireaug.camera.effects.light import flicker
from moireaug.scene.by_name import with_values

FREQUENCIES, DUTIES, PHASES = (50.0, 240.0, 1000.0), (0.1, 0.5, 0.9, 1.0), (0.0, 0.35)
SHUTTERS, READOUTS = (1 / 5000, 1 / 240, 1 / 60), (0.0, 1 / 30)
CASES = torch.tensor(
    list(itertools.product(FREQUENCIES, DUTIES, PHASES, SHUTTERS, READOUTS)), dtype=torch.float64
)
ROWS = torch.linspace(0.0, 1.0, 9, dtype=torch.float64)


def summed(rows, frequency, duty, phase, shutter, readout, moments=8000):
    """Share of a row's exposure during which the panel is on, over `duty`."""
    t = (torch.arange(moments) + 0.5) / moments
    cycles = phase + frequency * (readout * rows[:, None] + shutter * t)
    return (cycles % 1 < duty).double().mean(1) / duty


def test_the_closed_form_is_the_sum():
    bands = flicker(ROWS, *CASES.T)
    assert bands.shape == (len(CASES), len(ROWS))
    for row, case in zip(bands, CASES.tolist(), strict=True):
        # two edges a cycle fall between moments
        assert (row - summed(ROWS, *case)).abs().max() < 5e-3
    # negative control: another phase
    shifted = CASES[1] + torch.tensor([0, 0, 0.1, 0, 0])
    assert (bands[1] - summed(ROWS, *shifted.tolist())).abs().max() > 0.5


def test_what_does_not_flicker_is_one():
    cases = [  # steady, always on, no shutter, two cycles, three cycles
        [0.0, 0.5, 0.4, 0.01, 0.02], [200.0, 1.0, 0.4, 0.001, 0.02], [200.0, 0.5, 0.4, 0.0, 0.02],
        [200.0, 0.3, 0.4, 0.01, 0.02], [100.0, 0.7, 0.4, 0.03, 0.02],
    ]  # fmt: skip
    assert (flicker(ROWS, *torch.tensor(cases, dtype=torch.float64).T) - 1).abs().max() < 1e-12


def test_rows_over_whole_bands_have_the_panels_mean():
    rows = (torch.arange(3000, dtype=torch.float64) + 0.5) / 3000
    cases = [[150.0, d, 0.2, s, 1 / 50] for d in (0.2, 0.6) for s in (1 / 2000, 1 / 77)]
    fields = torch.tensor(cases, dtype=torch.float64).T
    assert flicker(rows, *fields).mean(1).tolist() == pytest.approx([1.0] * 4, abs=1e-3)


def test_rows_of_each_image_are_its_own():
    fields = CASES[:3].T
    rows = torch.stack([ROWS, ROWS / 2, ROWS.flip(0)])
    together = flicker(rows, *fields)
    for i in range(3):
        assert torch.equal(together[i : i + 1], flicker(rows[i], *fields[:, i : i + 1]))


def test_gradients_of_every_field():
    def fields(*values):
        return [torch.tensor([v], dtype=torch.float64, requires_grad=True) for v in values]

    given = fields(230.0, 0.43, 0.17, 1 / 310, 1 / 47)
    assert torch.autograd.gradcheck(lambda *f: flicker(ROWS, *f), given, eps=1e-8, atol=1e-4)
    # a guard that must not leak into a gradient
    for frequency, shutter in ((0.0, 0.01), (200.0, 0.0)):
        given = fields(frequency, 0.5, 0.1, shutter, 0.02)
        flicker(ROWS, *given).sum().backward()
        assert all(f.grad.isfinite().all() for f in given if f.grad is not None)


# what leaves a flat screen's light over the rows alone
PLAIN = dict.fromkeys(("view.yaw", "view.pitch", "view.roll", "lens.k1", "panel.glare"), 0.0) | {
    "sensor.read_noise": 0.0,
    "sensor.gain": 0.5,
    "sensor.exposure": "mean",
}


def test_the_dimmed_phone_s_bands_have_the_period_and_depth_of_their_closed_form():
    """`pwm * readout` bands a photo, of depth 2 sinc(duty) |sinc(pwm * shutter)|, in the ranges
    that the preset states."""
    scene = with_values(Scene.preset("phone_at_dimmed_phone"), PLAIN)
    assert "flicker" in scene.plan((512, 64))
    shot = scene.sample(24, (512, 64), torch.Generator().manual_seed(0))
    raw = expose(torch.full((24, 3, 512, 64), 0.5), shot)[:, 1].double().mean(2)
    bands = shot.panel.pwm * shot.sensor.readout
    rows = (torch.arange(512, dtype=torch.float64) + 0.5) / 512
    orders = torch.arange(1, 40, dtype=torch.float64)
    waves = 2 * math.pi * bands[:, None, None] * orders * rows[:, None]
    fit = torch.cat([torch.ones(24, 512, 1), waves.cos(), waves.sin()], -1).double()
    found = torch.linalg.lstsq(fit, raw[..., None]).solution[..., 0]
    depth = found[:, [1, 40]].norm(dim=1) / found[:, 0]
    expected = 2 * torch.sinc(shot.panel.duty) * torch.sinc(shot.panel.pwm * shot.sensor.shutter)
    seen = bands > 2.5  # fewer are no waves of their own
    assert seen.sum() > 10 and expected.abs()[seen].max() > 0.3
    assert torch.allclose(depth[seen], expected.abs()[seen], atol=0.02)
