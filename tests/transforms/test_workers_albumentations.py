"""The seeds of albumentations transforms in the workers of a DataLoader."""

# isort: skip  # after moireaug, which keeps it from asking for its newest version
import functools
import types
from collections import deque

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


class Same(Dataset):
    def __init__(self, transform):
        self.transform = transform

    def __len__(self):
        return 8

    def __getitem__(self, i):
        return torch.from_numpy(self.transform(image=np.full((9, 12, 3), 128, np.uint8))["image"])


def test_seeded_workers_draw_differently_and_reproducibly(registered):
    data = Subset(Same(A.Compose([RandomMoire(registered, p=1)], seed=0)), range(8))

    def epochs():
        torch.manual_seed(0)
        loader = DataLoader(data, batch_size=2, num_workers=2, worker_init_fn=moire.seed_worker)
        return torch.cat([torch.cat(list(loader)) for _ in range(2)])

    first = epochs()
    assert len({x.numpy().tobytes() for x in first}) == 16
    assert torch.equal(first, epochs())


def test_a_worker_without_a_transform_says_so(monkeypatch):
    info = type("Info", (), {"dataset": Same(None)})
    monkeypatch.setattr(torch.utils.data, "get_worker_info", lambda: info)
    with pytest.raises(ValueError, match="found no albumentations transform that Same leads to"):
        moire.seed_worker(0)


def test_seeding_outside_a_worker_says_so():
    with pytest.raises(RuntimeError, match=r"pass it as DataLoader\(worker_init_fn="):
        moire.seed_worker(0)


class Views(Dataset):
    """Two views of one image, as contrastive learning takes them; whatever else is held must not
    hide a transform."""

    def __init__(self, weak, strong, **more):
        self.weak = weak
        self.held = {"normalise": A.Compose([A.Normalize()]), "strong": Wrapped(strong)}
        self.parent = self  # a cycle
        vars(self).update(more)

    def __len__(self):
        return 8

    def __getitem__(self, i):
        image = np.full((9, 12, 3), 128, np.uint8)
        views = (
            self.weak(image=image)["image"],
            self.held["strong"].transform(image=image)["image"],
        )
        return torch.from_numpy(np.stack(views))


class Wrapped:
    def __init__(self, transform):
        self.transform = transform


def test_every_transform_of_a_data_set_has_a_seed_of_its_own(registered):
    weak, strong = (A.Compose([RandomMoire(registered, p=1)], seed=0) for _ in range(2))
    torch.manual_seed(0)
    loader = DataLoader(
        Views(weak, strong), batch_size=2, num_workers=2, worker_init_fn=moire.seed_worker
    )
    views = torch.cat([torch.cat(list(loader)) for _ in range(2)]).flatten(0, 1)
    assert len({view.numpy().tobytes() for view in views}) == 2 * 16


class Slotted(Dataset):
    __slots__ = ("transform",)

    def __init__(self, transform):
        self.transform = transform


def test_transforms_in_slots_and_partial_functions_are_found(registered):
    one, other = (A.Compose([RandomMoire(registered, p=1)]) for _ in range(2))
    assert transforms_of(Slotted(one)) == [one]
    assert transforms_of(Same(functools.partial(one, image=None))) == [one]
    assert transforms_of(Slotted([one, functools.partial(len, other)])) == [one, other]


def test_a_transform_that_two_attributes_share_is_found_once(registered):
    one = A.Compose([RandomMoire(registered, p=1)])
    data = Views(one, one, again=[one, {"deep": (one,)}])
    assert len(transforms_of(data)) == 2  # with the one that normalises


def seeded():
    return A.Compose([A.GaussNoise(p=1)], seed=0)


GLOBAL, NESTED, OF_A_METHOD = seeded(), seeded(), seeded()
augmentation = types.ModuleType("augmentation")
augmentation.STEPS = seeded()


def by_global(image):
    return GLOBAL(image=image)


def by_nested_global(image):
    def call():
        return NESTED(image=image)

    return call()


def by_module(image):
    return augmentation.STEPS(image=image)


def in_closure(transform):
    return lambda image: transform(image=image)


def in_default(transform):
    return lambda image, steps=transform: steps(image=image)


def in_keyword_default(transform):
    def call(image, *, steps=transform):
        return steps(image=image)

    return call


def in_decorated_function(transform):
    return functools.lru_cache(maxsize=0)(functools.wraps(len)(in_closure(transform)))


class Method(Wrapped):
    def call(self, image):
        return self.transform(image=image)


class Property:
    @property
    def steps(self):
        return OF_A_METHOD

    def __call__(self, image):
        return self.steps(image=image)


class OfClass:
    steps = seeded()

    def __call__(self, image):
        return self.steps(image=image)


class Module(nn.Module):
    def __init__(self, transform):
        super().__init__()
        self.weight = nn.Parameter(torch.zeros(2))
        self.transform = transform

    def forward(self, image):
        return self.transform(image=image)


class Recorded(Dataset):
    """The results of one transform, however it is held: a call of image= that returns a dict."""

    def __init__(self, call):
        self.call = call

    def __len__(self):
        return 4

    def __getitem__(self, i):
        return torch.from_numpy(self.call(image=np.full((6, 8, 3), 128, np.uint8))["image"])


class Torchvision(Recorded):
    def __getitem__(self, i):
        return self.call(torch.full((3, 6, 8), 128, dtype=torch.uint8))


def in_torchvision_lambda(transform):
    def call(image):
        return torch.from_numpy(transform(image=image.permute(1, 2, 0).numpy())["image"])

    return Torchvision(v2.Compose([v2.RandomHorizontalFlip(p=1), v2.Lambda(call)]))


HOLDERS = {
    "closure": lambda t: Recorded(in_closure(t)),
    "default": lambda t: Recorded(in_default(t)),
    "keyword default": lambda t: Recorded(in_keyword_default(t)),
    "global": lambda t: Recorded(by_global),
    "global of a nested function": lambda t: Recorded(by_nested_global),
    "a module's attribute": lambda t: Recorded(by_module),
    "decorated function": lambda t: Recorded(in_decorated_function(t)),
    "partial function": lambda t: Recorded(functools.partial(in_closure(t))),
    "bound method": lambda t: Recorded(Method(t).call),
    "global of a property": lambda t: Recorded(Property()),
    "class attribute": lambda t: Recorded(OfClass()),
    "modules": lambda t: Recorded(Module(Module(t))),
    "torchvision Compose": in_torchvision_lambda,
    "deque": lambda t: Recorded(functools.partial(lambda q, image: q[0](image=image), deque([t]))),
}


@pytest.fixture(scope="module")
def draws():
    """Two runs of two epochs in two workers: every image, by holder."""
    data = ConcatDataset([hold(seeded()) for hold in HOLDERS.values()])

    def epochs():
        torch.manual_seed(0)
        loader = DataLoader(data, batch_size=2, num_workers=2, worker_init_fn=moire.seed_worker)
        images = torch.stack([torch.cat(list(loader)) for _ in range(2)])
        return images.unflatten(1, (len(HOLDERS), 4)).transpose(0, 1)

    return epochs(), epochs()


@pytest.mark.parametrize("place", range(len(HOLDERS)), ids=list(HOLDERS))
def test_transforms_are_seeded_however_they_are_held(place, draws):
    first, again = (run[place].flatten(0, 1) for run in draws)
    assert len({image.numpy().tobytes() for image in first}) == 8
    assert torch.equal(first, again)


@pytest.mark.parametrize("holder", HOLDERS)
def test_each_holder_leads_to_its_transform_once(holder):
    one = seeded()
    data = HOLDERS[holder](one)
    transforms = transforms_of(data)
    assert len(transforms) == 1
    assert transforms_of(ConcatDataset([data, data])) == transforms


def made_anew(image):
    return A.Compose([A.GaussNoise(p=1)])(image=image)


@pytest.mark.parametrize(
    "call",
    [
        made_anew,
        functools.partial(made_anew, image=[seeded()] * 1001),
        {seeded()},
        map(seeded().__call__, []),
        torch.zeros(3),
        A.Compose,
        torch,
    ],
    ids=["made anew", "long list", "set", "iterator", "tensor", "library's class", "library"],
)
def test_what_leads_to_no_transform_is_refused(call, monkeypatch):
    info = type("Info", (), {"dataset": Recorded(call)})
    monkeypatch.setattr(torch.utils.data, "get_worker_info", lambda: info)
    with pytest.raises(ValueError, match="that Recorded leads to"):
        moire.seed_worker(0)
