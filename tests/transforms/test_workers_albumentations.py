"""The seeds of albumentations transforms in the workers of a DataLoader."""

# isort: skip  # after the door, which keeps it from asking for its newest version
import functools

import albumentations as A
import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, Dataset, Subset

from moireaug.transforms import albumentations as door
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
        loader = DataLoader(data, batch_size=2, num_workers=2, worker_init_fn=door.seed_worker)
        return torch.cat([torch.cat(list(loader)) for _ in range(2)])

    first = epochs()
    assert len({x.numpy().tobytes() for x in first}) == 16
    assert torch.equal(first, epochs())


def test_a_worker_without_a_transform_says_so(monkeypatch):
    info = type("Info", (), {"dataset": Same(None)})
    monkeypatch.setattr(torch.utils.data, "get_worker_info", lambda: info)
    with pytest.raises(
        ValueError, match="found no albumentations transform among the attributes of Same"
    ):
        door.seed_worker(0)


def test_seeding_outside_a_worker_says_so():
    with pytest.raises(RuntimeError, match=r"pass it as DataLoader\(worker_init_fn="):
        door.seed_worker(0)


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
        Views(weak, strong), batch_size=2, num_workers=2, worker_init_fn=door.seed_worker
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
