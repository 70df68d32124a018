"""How visible a change is, also in images smaller than a window."""

import pytest
import torch

from moireaug.evaluation.visibility import ssim


@pytest.mark.parametrize("side", [1, 3, 5, 6, 16])
def test_structural_similarity_is_defined_at_any_size(side):
    images = torch.rand(2, 3, side, 9, generator=torch.Generator().manual_seed(0))
    assert ssim(images, images).tolist() == pytest.approx([1.0, 1.0])
    changed = ssim((images + 0.3).clamp(0, 1), images)
    assert changed.shape == (2,) and ((changed > -1) & (changed < 0.99)).all()
