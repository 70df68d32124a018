"""What the tests of the transforms share: pixel values, and a sample of every leaf."""

import torch
from torchvision import tv_tensors


def values(shape, dtype, seed=0):
    x = torch.rand(shape, generator=torch.Generator().manual_seed(seed))
    return (x * 255).round().to(dtype) if dtype == torch.uint8 else x.to(dtype)


def sample_of_leaves(image):
    return {
        "image": image,
        "mask": tv_tensors.Mask(torch.ones(2, 9, 12, dtype=torch.uint8)),
        "boxes": tv_tensors.BoundingBoxes(
            [[1.0, 2.0, 5.0, 6.0]], format="XYXY", canvas_size=(9, 12)
        ),
        "points": tv_tensors.KeyPoints([[1.0, 2.0]], canvas_size=(9, 12)),
        "label": torch.tensor(3),
        "name": "a",
        "id": 7,
    }
