"""What the tests of evaluations share: a small model, right about every image of two batches."""

import pytest
import torch
from torch import nn


def classifier(seed=0, classes=4):
    torch.manual_seed(seed)
    return nn.Sequential(
        nn.Conv2d(3, 6, 3, 2),
        nn.ReLU(),
        nn.AdaptiveAvgPool2d(3),
        nn.Flatten(),
        nn.Linear(54, classes),
    )


@pytest.fixture(scope="session")
def known():
    """(model, batches): two batches of eight images with the labels that the model gives them."""
    g = torch.Generator().manual_seed(0)
    model = classifier().eval()
    images = [torch.rand(8, 3, 16, 16, generator=g) for _ in range(2)]
    with torch.no_grad():
        return model, [(x, model(x).argmax(1)) for x in images]
