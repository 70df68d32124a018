"""What the torchvision transforms refuse, and where they send it."""

import numpy as np
import PIL.Image
import pytest
import torch
from torchvision import tv_tensors

from moireaug.transforms import RandomMoire
from tests.transforms.common import CAMERA, REGISTERED

IMAGE = torch.rand(3, 9, 12)
PAIR = tv_tensors.Image(torch.rand(2, 3, 9, 12))
ROTATED = tv_tensors.BoundingBoxes(torch.rand(1, 5), format="CXCYWHR", canvas_size=(9, 12))
BOXES = tv_tensors.BoundingBoxes(torch.rand(2, 4), format="XYXY", canvas_size=(9, 12))


@pytest.mark.parametrize(
    ("sample", "error", "sentence"),
    [
        (torch.rand(9, 12), ValueError, r"\(C, H, W\).*got \(9, 12\)\. Give a grey image its"),
        (torch.rand(3, 0, 8), ValueError, r"H, W >= 1; got \(1, 3, 0, 8\)"),
        (torch.rand(2, 2, 3, 9, 12), ValueError, "tv_tensors.Video"),
        (IMAGE * torch.nan, ValueError, "finite"),
        ((IMAGE * 9).to(torch.int32), TypeError, "uint8 or floating point"),
        (PIL.Image.new("P", (12, 9)), ValueError, r"mode RGB, L, RGBA, LA; got P.*v2\.RGB"),
        (PIL.Image.new("CMYK", (12, 9)), ValueError, "got CMYK"),
        ((tv_tensors.Image(IMAGE), PAIR), ValueError, "batch size; got 1 and 2"),
        ((tv_tensors.Image(IMAGE), ROTATED), ValueError, "rotated boxes"),
        ((PAIR, BOXES), ValueError, "which of 2 images"),
        ((PAIR, tv_tensors.Mask(torch.ones(9, 12))), ValueError, "which of 2"),
    ],
)
def test_errors_are_sentences(sample, error, sentence):
    with pytest.raises(error, match=sentence):
        RandomMoire(CAMERA, p=1)(sample)


@pytest.mark.parametrize("p", [0.0, 1.0])
def test_what_is_not_chosen_is_refused_all_the_same(p):
    transform, picture = RandomMoire(REGISTERED, p=p), np.zeros((9, 12, 3), np.uint8)
    for sample in (picture, picture[..., 0] / 1.0, (picture, 3), {"image": picture[None]}):
        with pytest.raises(TypeError, match=r"moireaug\.transforms\.albumentations\.RandomMoire"):
            transform(sample)
    channels_last = {(9, 12, 3): r"permute\(2, 0, 1\)", (2, 9, 12, 1): r"permute\(0, 3, 1, 2\)"}
    for shape, order in channels_last.items():
        for dtype in (torch.uint8, torch.float32):
            with pytest.raises(ValueError, match=order):
                transform(torch.zeros(shape, dtype=dtype))


def test_deep_pil_images_are_not_sent_where_they_turn_white():
    for mode in ("I", "F", "I;16"):
        with pytest.raises(ValueError, match=r"Scale it to float in \[0, 1\]"):
            RandomMoire(REGISTERED, p=1)(PIL.Image.new(mode, (12, 9)))
