"""White balance."""

import torch

from moireaug.effects.tone import balance


def test_balance_leaves_green_alone():
    photo = torch.rand(2, 3, 4, 5)
    red, blue = (
        torch.tensor([1.5, 0.5], dtype=torch.float64),
        torch.tensor([1.0, 2.0], dtype=torch.float64),
    )
    out = balance(photo, red, blue)
    assert out.dtype == photo.dtype and torch.equal(out[:, 1], photo[:, 1])
    assert torch.allclose(out[0, 0], 1.5 * photo[0, 0]) and torch.allclose(
        out[1, 2], 2 * photo[1, 2]
    )
    assert torch.equal(out[0, 2], photo[0, 2]) and torch.allclose(out[1, 0], 0.5 * photo[1, 0])
