"""The seeds of albumentations transforms in the workers of a DataLoader."""

# isort: skip  # after moireaug, which keeps it from asking for its newest version
import functools

import albumentations as A
import numpy as np
import pytest
import torch
from torch import nn
from torch.utils.data import ConcatDataset, DataLoader, Dataset, Subset
from torchvision.transforms import v2

from moireaug.transforms import albumentations as moire
from moireaug.transforms._workers import transforms_of
from moireaug.transforms.albumentations import RandomMoire
from tests.transforms.common import REGISTERED

PICTURE = np.full((9, 12, 3), 128, np.uint8)


class Same(Dataset):
    def __init__(self, call):
        self.call = call

    def __len__(self):
        return 4

    def __getitem__(self, i):
        return torch.from_numpy(self.call(image=PICTURE)["image"])


class Wrapped:
    def __init__(self, transform):
        self.transform = transform

    def call(self, image):
        return self.transform(image=image)


class Views(Same):
    """Two views of one image, as contrastive learning takes them; whatever else is held must not
    hide a transform."""

    def __init__(self, weak, strong, **more):
        self.weak = weak
        self.held = {"normalise": A.Compose([A.Normalize()]), "strong": Wrapped(strong)}
        self.parent = self  # a cycle
        vars(self).update(more)

    def __getitem__(self, i):
        views = self.weak(image=PICTURE), self.held["strong"].call(PICTURE)
        return torch.from_numpy(np.stack([view["image"] for view in views]))


def epochs(data, n=2):
    """Every image of the epochs in two seeded workers."""
    torch.manual_seed(0)
    loader = DataLoader(data, num_workers=2, worker_init_fn=moire.seed_worker)
    return torch.cat([torch.cat(list(loader)) for _ in range(n)])


def n_different(images):
    return len({image.numpy().tobytes() for image in images})


def test_seeded_workers_draw_differently_and_reproducibly():
    data = Subset(Same(A.Compose([RandomMoire(REGISTERED, p=1)], seed=0)), range(4))
    first = epochs(data)
    assert n_different(first) == 8 and torch.equal(first[:4], epochs(data, 1))


def test_every_transform_of_a_data_set_has_its_own_seed():
    weak, strong = (A.Compose([RandomMoire(REGISTERED, p=1)], seed=0) for _ in range(2))
    assert n_different(epochs(Views(weak, strong), 1).flatten(0, 1)) == 2 * 4


def test_seeding_outside_a_worker_says_so():
    with pytest.raises(RuntimeError, match=r"pass it as DataLoader\(worker_init_fn="):
        moire.seed_worker(0)


def test_a_transform_that_two_attributes_share_is_found_once():
    one = A.Compose([RandomMoire(REGISTERED, p=1)])
    data = Views(one, one, again=[one, {"deep": (one,)}])
    assert len(transforms_of(data)) == 2  # with the one that normalises


def seeded():
    return A.Compose([A.GaussNoise(p=1)], seed=0)


GLOBAL = seeded()


def by_global(image):
    return GLOBAL(image=image)


def in_closure(transform):
    return lambda image: transform(image=image)


class Module(nn.Module):
    def __init__(self, transform):
        super().__init__()
        self.weight = nn.Parameter(torch.zeros(2))
        self.transform = transform


HOLDERS = {
    "closure": in_closure,
    "default": lambda t: lambda image, steps=t: steps(image=image),
    "global": lambda t: by_global,
    "partial function": lambda t: functools.partial(in_closure(t)),
    "bound method": lambda t: Wrapped(t).call,
    "modules": lambda t: Module(Module(t)),
    "torchvision Compose": lambda t: v2.Compose([v2.Lambda(in_closure(t))]),
}


def test_each_holder_leads_to_its_transform_once():
    for name, holder in HOLDERS.items():
        data = Same(holder(seeded()))
        transforms = transforms_of(data)
        assert len(transforms) == 1, name
        assert transforms_of(ConcatDataset([data, data])) == transforms


def made_anew(image):
    return A.Compose([A.GaussNoise(p=1)])(image=image)


def test_what_leads_to_no_transform_is_refused(monkeypatch):
    long = functools.partial(made_anew, image=[seeded()] * 1001)
    for call in (None, made_anew, long, {seeded()}, map(seeded().__call__, [])):
        info = type("Info", (), {"dataset": Same(call)})
        monkeypatch.setattr(torch.utils.data, "get_worker_info", lambda info=info: info)
        with pytest.raises(ValueError, match="that Same leads to"):
            moire.seed_worker(0)
