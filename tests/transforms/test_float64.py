"""float64 images, as `image / 255.` makes them, are computed in float32 and returned in float64."""

import numpy as np
import pytest
import torch

from moireaug import Scene, capture
from moireaug.camera import pipeline
from moireaug.transforms import AdversarialMoire, RandomMoire
from moireaug.transforms import albumentations as for_arrays
from moireaug.transforms import kornia as for_batches

SCENE = Scene.preset("screen_photo")
IMAGE = torch.rand(1, 3, 12, 16, generator=torch.Generator().manual_seed(0)).double()


def by_albumentations(image):
    array = image[0].permute(1, 2, 0).numpy()
    photo = for_arrays.RandomMoire(SCENE, p=1.0)(image=array)["image"]
    assert photo.dtype == np.float64
    return torch.from_numpy(photo).permute(2, 0, 1)[None]


def by_attack_of_a_function(image):
    attack = AdversarialMoire(lambda x: x.mean((2, 3)), SCENE, steps=1, p=1.0)
    return attack(image, torch.tensor([0]))[0]


TRANSFORMS = {
    "torchvision": RandomMoire(SCENE, p=1.0),
    "kornia": for_batches.RandomMoire(SCENE, p=1.0),
    "albumentations": by_albumentations,
    "adversarial": by_attack_of_a_function,
}


@pytest.mark.parametrize("name", TRANSFORMS)
def test_every_transform_computes_it_in_float32(name, monkeypatch):
    def refuse(*_):
        raise AssertionError("the reference was called")

    monkeypatch.setattr(pipeline, "expose", refuse)
    photo = TRANSFORMS[name](IMAGE)
    assert photo.dtype == torch.float64 and photo.shape == IMAGE.shape
    assert (photo - IMAGE).abs().max() > 0.05


def test_capture_computes_it_in_float64(monkeypatch):
    called, expose = [], pipeline.expose
    monkeypatch.setattr(
        pipeline, "expose", lambda *given, **named: called.append(1) or expose(*given, **named)
    )
    assert capture(IMAGE, SCENE.sample(1, (12, 16))).dtype == torch.float64 and called


def test_a_gradient_comes_back_in_float64():
    image = IMAGE.clone().requires_grad_()
    RandomMoire(SCENE, p=1.0)(image).sum().backward()
    assert image.grad.dtype == torch.float64 and image.grad.abs().sum() > 0
