"""Flicker: the closed form against the light of every moment, summed."""

import itertools

import pytest
import torch

from moireaug.effects.flicker import flicker

FREQUENCIES, DUTIES, PHASES = (50.0, 240.0, 1000.0), (0.1, 0.5, 0.9, 1.0), (0.0, 0.35)
SHUTTERS, READOUTS = (1 / 5000, 1 / 240, 1 / 60), (0.0, 1 / 30)
CASES = torch.tensor(
    list(itertools.product(FREQUENCIES, DUTIES, PHASES, SHUTTERS, READOUTS)), dtype=torch.float64
)
ROWS = torch.linspace(0.0, 1.0, 9, dtype=torch.float64)


def summed(rows, frequency, duty, phase, shutter, readout, moments=20000):
    """Share of a row's exposure during which the panel is on, over `duty`."""
    t = (torch.arange(moments) + 0.5) / moments
    cycles = phase + frequency * (readout * rows[:, None] + shutter * t)
    return (cycles % 1 < duty).double().mean(1) / duty


def test_the_closed_form_is_the_sum():
    bands = flicker(ROWS, *CASES.T)
    assert bands.shape == (len(CASES), len(ROWS))
    for row, case in zip(bands, CASES.tolist(), strict=True):
        # two edges a cycle fall between moments
        assert (row - summed(ROWS, *case)).abs().max() < 2e-3


def test_a_wrong_phase_is_noticed():
    bands, shifted = flicker(ROWS, *CASES.T), CASES + torch.tensor([0, 0, 0.1, 0, 0])
    wrong = torch.stack([summed(ROWS, *case) for case in shifted.tolist()])
    assert (bands - wrong).abs().max() > 0.5


@pytest.mark.parametrize(
    ("frequency", "duty", "shutter"),
    [
        (0.0, 0.5, 0.01),
        (200.0, 1.0, 0.001),
        (200.0, 0.5, 0.0),
        (200.0, 0.3, 0.01),
        (100.0, 0.7, 0.03),
    ],
    ids=["steady", "always on", "no shutter", "two cycles", "three cycles"],
)
def test_what_does_not_flicker_is_one(frequency, duty, shutter):
    fields = (torch.tensor([v], dtype=torch.float64) for v in (frequency, duty, 0.4, shutter, 0.02))
    assert (flicker(ROWS, *fields) - 1).abs().max() < 1e-12


def test_rows_over_whole_bands_have_the_panels_mean():
    rows = (torch.arange(3000, dtype=torch.float64) + 0.5) / 3000
    fields = (
        torch.tensor([[150.0, d, 0.2, s, 1 / 50] for d in (0.2, 0.6) for s in (1 / 2000, 1 / 77)])
        .double()
        .T
    )
    assert flicker(rows, *fields).mean(1).tolist() == pytest.approx([1.0] * 4, abs=1e-3)


def test_rows_of_each_image_are_its_own():
    fields = CASES[:3].T
    rows = torch.stack([ROWS, ROWS / 2, ROWS.flip(0)])
    together = flicker(rows, *fields)
    for i in range(3):
        assert torch.equal(together[i : i + 1], flicker(rows[i], *fields[:, i : i + 1]))


def test_gradients_of_every_field():
    fields = [
        torch.tensor([v], dtype=torch.float64, requires_grad=True)
        for v in (230.0, 0.43, 0.17, 1 / 310, 1 / 47)
    ]
    assert torch.autograd.gradcheck(lambda *f: flicker(ROWS, *f), fields, eps=1e-8, atol=1e-4)
    # a guard that must not leak into a gradient
    for frequency, shutter in ((0.0, 0.01), (200.0, 0.0)):
        given = [
            torch.tensor([v], dtype=torch.float64, requires_grad=True)
            for v in (frequency, 0.5, 0.1, shutter, 0.02)
        ]
        flicker(ROWS, *given).sum().backward()
        assert all(f.grad.isfinite().all() for f in given if f.grad is not None)
