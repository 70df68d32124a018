"""Arithmetic whose gradient is right at the bounds."""

import math

import pytest
import torch
from torch.autograd import forward_ad

from moireaug.common.numeric import clip, clip_straight_through, per_image, saturate, sinc


def test_black_and_white_pixels_are_attackable_and_a_full_well_is_not():
    x = torch.tensor([-0.5, 0.0, 0.5, 1.0, 1.5], requires_grad=True)
    cases = (
        (clip, [0, 0, 0.5, 1, 1], [0, 1, 1, 1, 0]),
        (saturate, [-0.5, 0, 0.5, 1, 1], [1] * 4 + [0]),
    )
    for function, values, slopes in cases:
        assert function(x).tolist() == function(x.detach()).tolist() == values
        assert torch.autograd.grad(function(x).sum(), x)[0].tolist() == slopes


def test_what_is_rounded_past_white_keeps_its_gradient():
    x = torch.tensor([-1e-9, 0.3, 1.0, 1 + 2.0**-23], requires_grad=True)
    found = clip_straight_through(x)
    assert found.min() == 0 and found.max() == 1 and found[1] == x[1]
    found.sum().backward()
    assert torch.equal(x.grad, torch.ones(4))


def test_the_derivatives_of_sinc_at_0():
    x = torch.tensor([0.0, 0.5, 1.0], dtype=torch.float64, requires_grad=True)
    torch.testing.assert_close(sinc(x), torch.sinc(x), rtol=0, atol=1e-16)
    (first,) = torch.autograd.grad(sinc(x).sum(), x, create_graph=True)
    (second,) = torch.autograd.grad(first.sum(), x)
    assert first[0] == 0 and second[0].item() == pytest.approx(-(math.pi**2) / 3)


def test_fields_of_a_shot_meet_images():
    field = per_image(torch.tensor([1.0, 2.0], dtype=torch.float64), torch.zeros(2, 3, 4, 5))
    assert field.shape == (2, 1, 1, 1) and field.dtype == torch.float32


@pytest.mark.filterwarnings("ignore:.torch.jit.script:FutureWarning")  # PyTorch's own call
@pytest.mark.parametrize("clipped", [clip, saturate])
def test_forward_and_backward_derivatives_agree_at_the_bounds(clipped):
    x = torch.tensor([-1.0, 0.0, 0.5, 1.0, 2.0], requires_grad=True)
    clipped(x).sum().backward()
    along = torch.func.jvp(clipped, (x.detach(),), (torch.ones(5),))[1]
    assert torch.equal(along, x.grad)
    with forward_ad.dual_level():
        dual = forward_ad.make_dual(x.detach(), torch.ones(5))
        assert torch.equal(forward_ad.unpack_dual(clipped(dual)).tangent, x.grad)
