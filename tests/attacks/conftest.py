"""What the tests of attacks share: a small model, a batch, and models that have learnt photos."""

import pytest
import torch
from torch import nn

from moireaug import capture
from tests.attacks.common import SCENE, striped


class Small(nn.Module):
    def __init__(self, classes=5):
        super().__init__()
        self.net = nn.Sequential(
            nn.Conv2d(3, 8, 3, 2),
            nn.BatchNorm2d(8),
            nn.ReLU(),
            nn.Dropout(0.5),
            nn.AdaptiveAvgPool2d(4),
            nn.Flatten(),
            nn.Linear(128, classes),
        )

    def forward(self, x):
        return self.net(x)


@pytest.fixture
def model():
    torch.manual_seed(3)
    return Small()


@pytest.fixture
def batch():
    g = torch.Generator().manual_seed(4)
    return torch.rand(6, 3, 16, 16, generator=g), torch.randint(0, 5, (6,), generator=g)


@pytest.fixture(scope="session")
def trained():
    """A model that has learnt, by sixty steps, on (B, 3, 16, 16) images of the given labels."""

    def train(images, labels):
        torch.manual_seed(0)
        model = Small()
        optimizer = torch.optim.Adam(model.parameters(), 0.01)
        for _ in range(60):
            optimizer.zero_grad()
            nn.functional.cross_entropy(model(images), labels).backward()
            optimizer.step()
        return model.eval()

    return train


@pytest.fixture(scope="session")
def learnt_photos(trained):
    """(model, images, labels, shot): a model that has learnt photos of n images."""

    def learn(n):
        g = torch.Generator().manual_seed(0)
        images, labels = striped(n, g)
        shot = SCENE.sample(n, (16, 16), g)
        return trained(capture(images, shot), labels), images, labels, shot

    return learn
