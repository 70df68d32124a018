"""AdversarialMoire in albumentations: one image at a time, its class passed as a target."""

import numpy as np
import pytest
import torch
from torch import nn

from moireaug import Shot
from moireaug.transforms import albumentations as door

import albumentations as A  # isort: skip  # after the door, which keeps it from asking for its newest version


@pytest.fixture
def model():
    torch.manual_seed(0)
    return nn.Sequential(
        nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4), nn.ReLU(), nn.AdaptiveAvgPool2d(2), nn.Flatten(), nn.Linear(16, 3)
    )


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
@pytest.mark.parametrize("shape", [(12, 14, 3), (12, 14)], ids=str)
def test_it_raises_the_loss(dtype, shape, model, registered):
    image = np.random.default_rng(0).random(shape)
    image = (image * 255).astype(np.uint8) if dtype == np.uint8 else image.astype(np.float32)
    attacked = door.AdversarialMoire(model, registered, eps=16 / 255, steps=5, p=1)
    steps = A.ReplayCompose([attacked])
    steps.set_random_seed(0)
    out = steps(image=image, label=1)
    assert out["image"].dtype == dtype and out["image"].shape == shape and out["label"] == 1
    params = out["replay"]["transforms"][0]["params"]
    plain = door.apply_shot(image, Shot.from_dict(params["shot"]))

    def loss(shown):
        x = torch.from_numpy(np.ascontiguousarray(shown)).float() / (255 if dtype == np.uint8 else 1)
        x = x.reshape(1, *shape[:2], -1).permute(0, 3, 1, 2).expand(-1, 3, -1, -1)
        with torch.no_grad():
            return nn.functional.cross_entropy(model.eval()(x), torch.tensor([1])).item()

    assert loss(out["image"]) > loss(plain)
    assert np.abs(np.array(params["noise"])).max() <= 16 / 255 + 1e-6


def test_mode_is_kept_and_draws_follow_the_seed(model, registered):
    image, model = np.random.default_rng(0).random((12, 14, 3)).astype(np.float32), model.train()
    pipeline = A.Compose([door.AdversarialMoire(model, registered, steps=2, p=1)], seed=3)
    same = A.Compose([door.AdversarialMoire(model, registered, steps=2, p=1)], seed=3)
    first = pipeline(image=image, label=0)["image"]
    assert np.array_equal(first, same(image=image, label=0)["image"])
    assert not np.array_equal(first, pipeline(image=image, label=0)["image"])
    assert model.training


def test_a_call_without_the_label_is_told_so(model, registered):
    with pytest.raises(ValueError, match="call the Compose with label=<int>"):
        A.Compose([door.AdversarialMoire(model, registered, p=1)])(image=np.zeros((8, 8, 3), np.uint8))
    with pytest.raises(ValueError, match=r"\[0, 2\], the model's classes"):
        A.Compose([door.AdversarialMoire(model, registered, p=1)])(image=np.zeros((8, 8, 3), np.uint8), label=7)
