"""Values that peers' resampling, blur and noise leave outside [0, 1] are clipped."""

# isort: skip  # after moireaug, which keeps it from asking for its newest version
import albumentations as A
import kornia.augmentation as K
import pytest
import torch
from torchvision.transforms import v2

from moireaug import Lens, Scene, Sensor, capture, expose
from moireaug.transforms import AdversarialMoire, RandomMoire, albumentations, kornia

import cv2  # isort: skip

DRAWS, SIZE = 24, (12, 16)
# a lens without blur would take twenty times as long
SCENE = Scene(lens=Lens(blur=0.4), sensor=Sensor(gain=2.0, exposure="mean"))
BICUBIC = v2.InterpolationMode.BICUBIC


@pytest.fixture(autouse=True)
def one_thread(_threads_and_seed):
    torch.set_num_threads(1)  # pictures this small do not share their work


def of_albumentations(step):
    def call(image):
        array = step(image=image.permute(1, 2, 0).numpy())["image"]
        return torch.from_numpy(array).permute(2, 0, 1)

    return call


AFFINE = K.RandomAffine(30, resample="bicubic", p=1.0, keepdim=True)
PEERS = {
    "v2.Resize bicubic": v2.Resize(SIZE, BICUBIC),
    "v2.GaussianNoise": v2.GaussianNoise(sigma=0.2, clip=False),
    "kornia.RandomAffine bicubic": AFFINE,
    "kornia.RandomGaussianNoise": K.RandomGaussianNoise(0.0, 0.2, p=1.0, keepdim=True),
    "albumentations.Affine Lanczos": of_albumentations(
        A.Affine(scale=(0.6, 1.8), rotate=(-30, 30), interpolation=cv2.INTER_LANCZOS4, p=1)
    ),
}


def drawn(name):
    """Draws: pictures with white areas, random pixels of black and white, and random ones."""
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
    photos = steps(images=images.permute(0, 2, 3, 1).numpy())["images"]
    return torch.from_numpy(photos).permute(0, 3, 1, 2)


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
    assert images.min() < -0.01 and images.max() > 1.01
    for entry in ENTRIES.values():
        torch.manual_seed(1)
        photos = entry(images)
        torch.manual_seed(1)
        assert torch.equal(photos, entry(images.clamp(0, 1)))
