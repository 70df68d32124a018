"""Arithmetic whose gradient is right at the bounds."""

import torch

from moireaug.numeric import clip, per_image, saturate


def test_black_and_white_pixels_are_attackable():
    x = torch.tensor([-0.5, 0.0, 0.5, 1.0, 1.5], requires_grad=True)
    assert clip(x).tolist() == clip(x.detach()).tolist() == [0, 0, 0.5, 1, 1]
    assert torch.autograd.grad(clip(x).sum(), x)[0].tolist() == [0, 1, 1, 1, 0]


def test_a_full_well_reads_one_and_passes_no_gradient():
    raw = torch.tensor([-0.5, 0.0, 0.5, 1.0, 1.5], requires_grad=True)
    full = saturate(raw)
    assert full.tolist() == saturate(raw.detach()).tolist() == [-0.5, 0, 0.5, 1, 1]
    assert torch.autograd.grad(full.sum(), raw)[0].tolist() == [1, 1, 1, 1, 0]


def test_fields_of_a_shot_meet_images():
    field = per_image(torch.tensor([1.0, 2.0], dtype=torch.float64), torch.zeros(2, 3, 4, 5))
    assert field.shape == (2, 1, 1, 1) and field.dtype == torch.float32
