"""The order of images in training: the same for any number of ranks, another in every epoch."""

import pytest
import torch
from torch.utils.data import TensorDataset

from training.data.batches import Batches

N = 60


def order(ranks, rank, epoch, seed=5):
    """The images that a rank's loader yields in an epoch."""
    data = TensorDataset(torch.arange(N), torch.arange(N))
    splits = type("Splits", (), {"train": data, "val": None})
    batches = Batches(splits, 8, workers=0, seed=seed)
    batches.trainer = type("Trainer", (), {"world_size": ranks, "global_rank": rank})
    loader = batches.train_dataloader()
    loader.sampler.set_epoch(epoch)
    return [image for images, _ in loader for image in images.tolist()]


def test_two_ranks_see_the_batches_of_one():
    alone, ranks = order(1, 0, epoch=1), [order(2, rank, epoch=1) for rank in range(2)]
    assert len(set(alone)) == len(alone) == N // 8 * 8
    for start in range(0, len(alone), 8):
        halves = [rank[start // 2 : start // 2 + 4] for rank in ranks]
        assert sorted(alone[start : start + 8]) == sorted(halves[0] + halves[1])


def test_the_order_follows_seed_and_epoch_alone():
    assert order(1, 0, epoch=1) == order(1, 0, epoch=1)
    assert order(1, 0, epoch=1) != order(1, 0, epoch=2)
    assert order(1, 0, epoch=1) != order(1, 0, epoch=1, seed=6)


@pytest.mark.parametrize(
    ("side", "ranks", "most"), [(32, 1, 320), (224, 1, 25), (4096, 1, 1), (448, 8, 1)]
)
def test_a_batch_of_validation_is_bounded_in_pixels(side, ranks, most):
    picture = torch.zeros(1, 1, 1, 1, dtype=torch.uint8).expand(400, 3, side, side)
    splits = type("Splits", (), {"val": TensorDataset(picture, torch.arange(400))})
    batches = Batches(splits, 8, workers=0, seed=0)
    batches.trainer = type("Trainer", (), {"world_size": ranks, "global_rank": 0})
    assert batches.val_dataloader().batch_size == most
