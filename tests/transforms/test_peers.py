"""Each peer's resampling, blur and noise in front of each transform: values left outside [0, 1] are
clipped."""

import functools

# isort: skip  # after moireaug, which keeps it from asking for its newest version
import albumentations as A
import kornia.augmentation as K
import numpy as np
import pytest
import torch
from torchvision.transforms import v2

from moireaug import Lens, Scene, Sensor, capture, expose
from moireaug.transforms import AdversarialMoire, RandomMoire, albumentations, kornia
from moireaug.transforms.torchvision import apply_shot

import cv2  # isort: skip

DRAWS, SIZE = 60, (12, 16)
# a lens without blur would take twenty times as long
SCENE = Scene(lens=Lens(blur=0.4), sensor=Sensor(gain=2.0, exposure="mean"))
BICUBIC = v2.InterpolationMode.BICUBIC


@pytest.fixture(autouse=True)
def one_thread(_threads_and_seed):
    torch.set_num_threads(1)  # pictures this small do not share their work


def of_torchvision(step):
    return lambda image: step(image)


def of_kornia(step):
    return lambda image: step(image[None])[0]


def of_albumentations(step):
    return lambda image: torch.from_numpy(
        step(image=image.permute(1, 2, 0).numpy())["image"]
    ).permute(2, 0, 1)


# whether some draws lie outside is what these libraries do today: a peer that clips is here so that
# it goes on to pass
PEERS = {
    "v2.Resize": of_torchvision(v2.Resize(SIZE)),
    "v2.Resize bicubic": of_torchvision(v2.Resize(SIZE, BICUBIC)),
    "v2.RandomResizedCrop": of_torchvision(v2.RandomResizedCrop(SIZE)),
    "v2.RandomResizedCrop bicubic": of_torchvision(
        v2.RandomResizedCrop(SIZE, interpolation=BICUBIC)
    ),
    "v2.GaussianBlur": of_torchvision(v2.GaussianBlur(5)),
    "v2.GaussianNoise": of_torchvision(v2.GaussianNoise(sigma=0.2, clip=False)),
    "kornia.RandomResizedCrop": of_kornia(K.RandomResizedCrop(SIZE, p=1.0)),
    "kornia.RandomAffine bicubic": of_kornia(K.RandomAffine(30, resample="bicubic", p=1.0)),
    "kornia.RandomGaussianBlur": of_kornia(K.RandomGaussianBlur((5, 5), (0.1, 2.0), p=1.0)),
    "kornia.RandomBoxBlur": of_kornia(K.RandomBoxBlur(p=1.0)),
    "kornia.RandomMotionBlur": of_kornia(K.RandomMotionBlur(5, 35.0, 0.5, p=1.0)),
    "kornia.RandomGaussianNoise": of_kornia(K.RandomGaussianNoise(0.0, 0.2, p=1.0)),
    "albumentations.Resize bicubic": of_albumentations(
        A.Resize(*SIZE, interpolation=cv2.INTER_CUBIC, p=1)
    ),
    "albumentations.Affine Lanczos": of_albumentations(
        A.Affine(scale=(0.6, 1.8), rotate=(-30, 30), interpolation=cv2.INTER_LANCZOS4, p=1)
    ),
    "albumentations.RandomResizedCrop Lanczos": of_albumentations(
        A.RandomResizedCrop(SIZE, scale=(0.3, 1.0), interpolation=cv2.INTER_LANCZOS4, p=1)
    ),
    "albumentations.GaussianBlur": of_albumentations(A.GaussianBlur(p=1)),
    "albumentations.MotionBlur": of_albumentations(A.MotionBlur(p=1)),
    "albumentations.GaussNoise": of_albumentations(A.GaussNoise(p=1)),
}
OVERSHOOT = [
    name
    for name in PEERS
    if any(k in name for k in ("bicubic", "Lanczos", "v2.GaussianN", "RandomGaussianN"))
]


@functools.cache
def drawn(name):
    """Sixty draws: pictures with white areas, random pixels of black and white, and random ones."""
    torch.manual_seed(0)
    many = []
    for i in range(DRAWS):
        image = torch.rand(3, 16, 20)
        image = (image > 0.5).float() if i % 3 == 1 else image
        if i % 3 == 2:
            image[:, :, 8:] = 1
        many.append(PEERS[name](image))
    return torch.stack(many)


def through_albumentations(images):
    steps = A.Compose([albumentations.RandomMoire(SCENE, p=1)], seed=0)
    return torch.from_numpy(steps(images=images.permute(0, 2, 3, 1).numpy())["images"]).permute(
        0, 3, 1, 2
    )


def through_attack(images):
    attack = AdversarialMoire(lambda x: x.mean((2, 3)), SCENE, steps=1)
    return attack(images, torch.zeros(len(images), dtype=torch.long))[0]


ENTRIES = {
    "torchvision": RandomMoire(SCENE, p=1),
    "kornia": kornia.RandomMoire(SCENE, p=1),
    "albumentations": through_albumentations,
    "AdversarialMoire": through_attack,
    "capture": lambda images: capture(images, SCENE.sample(len(images), images.shape[-2:])),
    "expose": lambda images: expose(images, SCENE.sample(len(images), images.shape[-2:])),
}


@pytest.mark.parametrize("name", PEERS)
def test_every_entry_takes_what_its_peers_hand_it(name):
    images = drawn(name)
    assert name not in OVERSHOOT or (images.min() < -0.01 and images.max() > 1.01)
    for entry in ENTRIES.values():
        torch.manual_seed(1)
        photos = entry(images)
        torch.manual_seed(1)
        assert torch.equal(photos, entry(images.clamp(0, 1)))


def test_single_images_pass_too():
    shot = SCENE.sample(1, (16, 20))
    for image in drawn("albumentations.Affine Lanczos")[:20]:
        photo = apply_shot(image, shot)
        array = albumentations.apply_shot(
            np.ascontiguousarray(image.permute(1, 2, 0).numpy()), shot
        )
        assert torch.equal(torch.from_numpy(array).permute(2, 0, 1), photo)


@pytest.mark.parametrize("name", ["torchvision", "kornia", "albumentations", "AdversarialMoire"])
@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda x: (x - 0.45) / 0.225, "look normalised"),
        (lambda x: x * 2 - 1, "look normalised"),
        (lambda x: x * 255, "Divide them by 255"),
        (lambda x: x * torch.nan, "NaN"),
        (lambda x: x / 0, "infinity|NaN"),
    ],
)
def test_every_entry_refuses_what_is_no_picture(spoil, sentence, name):
    with pytest.raises(ValueError, match=sentence):
        ENTRIES[name](spoil(torch.rand(4, 3, *SIZE)))
