"""What the torchvision transforms refuse, and where they send it."""

import numpy as np
import PIL.Image
import pytest
import torch
from torchvision import tv_tensors

from moireaug.transforms import RandomMoire

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
def test_errors_are_sentences(sample, error, sentence, camera):
    with pytest.raises(error, match=sentence):
        RandomMoire(camera, p=1)(sample)


@pytest.mark.parametrize("p", [0.0, 1.0])
@pytest.mark.parametrize(
    "sample",
    [
        np.zeros((9, 12, 3), np.uint8),
        np.zeros((9, 12), np.float32),
        (np.zeros((9, 12, 3), np.uint8), torch.tensor(3)),
        {"image": np.zeros((2, 9, 12, 3), np.uint8), "label": 1},
    ],
)
def test_numpy_images_are_sent_to_albumentations(sample, p, registered):
    with pytest.raises(TypeError, match=r"moireaug\.transforms\.albumentations\.RandomMoire"):
        RandomMoire(registered, p=p)(sample)


@pytest.mark.parametrize("p", [0.0, 1.0])
@pytest.mark.parametrize(
    ("shape", "order"),
    [((9, 12, 3), r"permute\(2, 0, 1\)"), ((2, 9, 12, 1), r"permute\(0, 3, 1, 2\)")],
)
@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32], ids=str)
def test_channels_last_are_told_how_to_come_first(dtype, shape, order, p, registered):
    with pytest.raises(ValueError, match=order):
        RandomMoire(registered, p=p)(torch.zeros(shape, dtype=dtype))


@pytest.mark.parametrize("mode", ["I", "F", "I;16"])
def test_deep_pil_images_are_not_sent_where_they_turn_white(mode, registered):
    with pytest.raises(ValueError, match=r"Scale it to float in \[0, 1\]"):
        RandomMoire(registered, p=1)(PIL.Image.new(mode, (12, 9)))
