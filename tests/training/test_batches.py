"""The order of images in training: windows that are replayed, parts of an epoch, and any number of
ranks."""

import pytest
import torch
from torch.utils.data import DataLoader, SequentialSampler, TensorDataset

from tests.training.small import TINY, configured
from training.batches import Batches, Part, Replayed


@pytest.mark.parametrize(("n", "replays", "window"), [(5, 3, 2), (4, 2, 2), (3, 1, 2), (2, 3, 16)])
def test_windows_of_batches_come_again_in_turn(n, replays, window):
    data = TensorDataset(torch.arange(n * 2), torch.arange(n * 2))
    loader = Replayed(DataLoader(data, 2, sampler=SequentialSampler(data)), replays, window)
    found = [(b.images[0].item() // 2, b.slot, b.visit) for b in loader]
    expected = [
        (start + slot, slot, visit)
        for start in range(0, n, window)
        for visit in range(replays)
        for slot in range(min(window, n - start))
    ]
    assert found == expected and len(loader) == len(found)


def test_parts_of_an_epoch_see_every_image_once_on_any_number_of_ranks():
    data = TensorDataset(torch.arange(60))
    for ranks in (1, 2):
        seen = []
        for epoch in range(3):
            for rank in range(ranks):
                part = Part(data, ranks, rank, seed=5, parts=3)
                part.set_epoch(epoch)
                seen += list(part)
                assert len(list(part)) == len(part) == 20 // ranks
        assert sorted(seen) == list(range(60))
    one, two = (Part(data, 1, 0, seed=5, parts=3) for _ in range(2))
    two.set_epoch(3)
    assert list(one) != list(two)


def test_loaders_draw_the_same_images_for_one_rank_and_two():
    cfg = configured("recipe=moire_free", *TINY, "adversary.replays=3")
    splits = type(
        "Splits", (), {"train": TensorDataset(torch.arange(60), torch.arange(60)), "val": None}
    )

    def drawn(ranks, rank):
        data = Batches(splits, cfg.train, cfg.adversary, workers=0, seed=cfg.seed)
        data.trainer = type("Trainer", (), {"world_size": ranks, "global_rank": rank})
        loader = data.train_dataloader()
        loader.sampler.set_epoch(1)
        return [i for b in loader for i in b.images.tolist()]

    halves = drawn(2, 0) + drawn(2, 1)
    assert sorted(drawn(1, 0)) == sorted(halves) and len(halves) == 3 * 20 == 3 * len(set(halves))
