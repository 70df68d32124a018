"""Quilting: nearest patch, cheapest cut, order of laying, against slow versions; the bank."""

import errno
import functools
import itertools
import os

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, TensorDataset

from moireaug.defenses import Quilting, bank
from moireaug.defenses.quilting import cut, stitch

draw_bank = functools.partial(bank.draw_bank, progress=False)
quilting_of = functools.partial(Quilting.from_images, progress=False)


def cheapest(error):
    """Every path of steps of at most one column, tried: (length, overlap) to its cost."""
    paths = itertools.product(range(error.shape[1]), repeat=len(error))
    connected = (p for p in paths if all(abs(a - b) <= 1 for a, b in itertools.pairwise(p)))
    return min(sum(error[i, c].item() for i, c in enumerate(p)) for p in connected)


def test_the_cut_is_the_cheapest_path():
    for length, overlap in ((5, 2), (6, 3), (4, 4), (3, 1), (1, 3)):
        error = torch.rand(12, length, overlap)
        fresh = cut(error)
        # old to the left, new to the right
        assert (fresh.int().diff(dim=-1) >= 0).all() and fresh[..., -1].all()
        at = overlap - fresh.sum(-1)
        assert (at.diff(dim=-1).abs() <= 1).all()
        cost = error.gather(-1, at[..., None]).sum((1, 2))
        assert torch.allclose(cost, torch.tensor([cheapest(e) for e in error]))


def laid_one_by_one(patches, chosen, overlap):
    """Stitching in reading order, one patch at a time."""
    side, (rows, cols) = patches.shape[-1], chosen.shape
    stride = side - overlap
    canvas = torch.zeros(3, side + (rows - 1) * stride, side + (cols - 1) * stride)
    for i in range(rows):
        for j in range(cols):
            new = patches[chosen[i, j]]
            here = canvas[:, i * stride : i * stride + side, j * stride : j * stride + side]
            error = (new - here).square().sum(0)
            take = torch.ones(side, side, dtype=torch.bool)
            if j:
                take[:, :overlap] &= cut(error[:, :overlap])
            if i:
                take[:overlap] &= cut(error[:overlap].T).T
            here[:, take] = new[:, take]
    return canvas


def test_all_at_once_is_one_by_one():
    shapes, patchings = ((1, 1), (1, 4), (5, 1), (4, 7), (7, 3)), ((5, 2), (4, 2), (6, 1), (7, 3))
    for (rows, cols), (side, overlap) in itertools.product(shapes, patchings):
        patches, chosen = torch.rand(50, 3, side, side), torch.randint(50, (2, rows, cols))
        expected = torch.stack([laid_one_by_one(patches, c, overlap) for c in chosen])
        assert torch.equal(stitch(patches, chosen, overlap), expected), (rows, cols, side)


def test_without_overlap_patches_are_tiles():
    patches, chosen = torch.rand(9, 3, 4, 4), torch.arange(6).view(1, 2, 3)
    tiles = patches[:6].view(2, 3, 3, 4, 4).permute(2, 0, 3, 1, 4).reshape(1, 3, 8, 12)
    assert torch.equal(stitch(patches, chosen, 0), tiles)


@pytest.mark.parametrize("blocks", [(1024, 2048), (7, 11)])
def test_the_nearest_patch_is_found(photos, monkeypatch, blocks):
    monkeypatch.setattr("moireaug.defenses.quilting.QUERIES_PER_BLOCK", blocks[0])
    monkeypatch.setattr("moireaug.defenses.quilting.PATCHES_PER_BLOCK", blocks[1])
    defence = quilting_of(photos(b=3), 700)
    asked = photos(b=1, seed=5).unfold(2, 5, 3).unfold(3, 5, 3)
    asked = asked.permute(0, 2, 3, 1, 4, 5).reshape(-1, 3, 5, 5)
    distance = torch.cdist(asked.flatten(1).double(), defence.bank.flatten(1).double())
    nearest = defence.nearest(asked)[:, None]
    found, beside = distance.gather(1, nearest), distance.gather(1, (nearest + 1) % 700)
    assert torch.allclose(found[:, 0], distance.amin(1), atol=1e-4)
    assert (found < beside).float().mean() > 0.9


@pytest.mark.parametrize(("h", "w"), [(20, 23), (21, 24), (22, 25), (5, 5)])
def test_an_image_whose_patches_are_in_the_bank_comes_back(photos, h, w):
    images = photos(b=1, h=h, w=w)
    # as far as no patch reaches that is partly mirrored
    h, w = (n if (n - 5) % 3 == 0 else 3 + (n - 5) // 3 * 3 for n in (h, w))
    defence = quilting_of(images, 10_000)
    assert torch.equal(defence(images)[..., :h, :w], images[..., :h, :w])
    noisy = (images + 0.01 * torch.randn(images.shape)).clamp(0, 1)
    out = defence(noisy)
    assert (out - images)[..., :h, :w].abs().mean() < 0.5 * (noisy - images).abs().mean()


def windows(images, patch=5):
    flat = images.unfold(2, patch, 1).unfold(3, patch, 1).permute(0, 2, 3, 1, 4, 5).flatten(3)
    return {tuple(p.tolist()) for p in flat.flatten(0, 2)}


def test_the_bank_holds_patches_of_the_images_without_repetition(photos):
    images = photos(b=3, h=12, w=14)
    drawn = draw_bank(images, 100)
    assert drawn.shape == (100, 3, 5, 5) and drawn.dtype == torch.float32
    assert len(windows(images) & {tuple(p.tolist()) for p in drawn.flatten(1)}) == 100
    everything = draw_bank(images, 10_000)
    assert len(everything) == 3 * 8 * 10 == len({tuple(p.tolist()) for p in everything.flatten(1)})
    assert not torch.equal(draw_bank(images, 100, seed=1), drawn)


def test_every_place_is_as_likely():
    images = torch.arange(4 * 6 * 7).view(4, 1, 6, 7).expand(-1, 3, -1, -1) / 200.0
    counts = torch.zeros(168)
    for seed in range(200):
        for batches in ([images], images.split(1)):
            corners = draw_bank(batches, 5, patch=5, seed=seed)[:, 0, 0, 0]
            counts[(corners * 200).round().long()] += 1
    counts = counts[counts > 0]
    assert len(counts) == 4 * 2 * 3
    assert (counts - 2000 / 24).abs().max() < 5 * (2 * 2000 / 24) ** 0.5


def test_the_bank_depends_neither_on_batches_nor_on_global_randomness(photos):
    images = photos(b=7, h=12, w=14)
    wanted = draw_bank(images, 60)
    state = torch.get_rng_state()
    for batches in (
        images.split(1),
        images.split(3),
        [(images, torch.zeros(7))],
        iter(images.double().split(2)),
    ):
        torch.rand(1)
        assert torch.equal(draw_bank(batches, 60), wanted)
    torch.set_rng_state(state)
    draw_bank(images, 60, seed=9)
    assert torch.equal(torch.get_rng_state(), state)


def test_the_file_is_used_only_where_it_matches(photos, tmp_path):
    """Else the bank is drawn anew, and the file replaced."""
    images, file = photos(b=3, h=12, w=14), tmp_path / "deep" / "bank.npz"
    first = draw_bank(images, 50, cache=file)
    assert [f.name for f in file.parent.iterdir()] == ["bank.npz"]
    written = written_at(file)
    again = quilting_of(images, 50, cache=str(file))
    assert torch.equal(again.bank, first) and written_at(file) == written
    other = images.clone()
    other[0, 0, 0, 0] = 1 - other[0, 0, 0, 0]
    changes = [({setting: 4}, images) for setting in ("patches", "patch", "seed")]
    for changed, given in (*changes, ({}, other), ({}, images[:2]), ({}, images.double())):
        draw_bank(images, 50, cache=file)  # so that this change alone differs
        settings = {"patches": 50} | changed
        wanted, before = draw_bank(given, **settings), written_at(file)
        assert torch.equal(draw_bank(given, **settings, cache=file), wanted)
        written = written_at(file)
        assert torch.equal(draw_bank(given, **settings, cache=file), wanted)
        assert before != written == written_at(file), changed


def written_at(file):
    return file.stat().st_ino, file.stat().st_mtime_ns


def test_loaders_are_told_apart_by_length(photos, tmp_path):
    def loader(n):
        return DataLoader(TensorDataset(photos(b=n, h=12, w=14), torch.zeros(n)), batch_size=2)

    settings = {"patches": 20}
    cache = tmp_path / "bank"
    first = draw_bank(loader(3), **settings, cache=cache)
    assert torch.equal(first, draw_bank(photos(b=3, h=12, w=14), **settings))
    assert not torch.equal(draw_bank(loader(4), **settings, cache=cache), first)
    written = written_at(cache)
    assert len(draw_bank(loader(4), **settings, cache=cache)) == 20
    assert written_at(cache) == written


def empty_array(file):
    with file.open("wb") as f:
        np.save(f, np.zeros(3))


def test_a_broken_file_is_drawn_anew(photos, tmp_path):
    images, file = photos(h=12, w=14), tmp_path / "bank.npz"
    wanted = draw_bank(images, 50, cache=file)
    whole = file.read_bytes()
    flipped = whole[:3000] + b"\xff\x00\xff" + whole[3003:]
    cut = [lambda data=data: file.write_bytes(data) for data in (b"", b"no", whole[:-100], flipped)]
    for harm in (*cut, lambda: np.savez(file, bank=np.zeros(3)), lambda: empty_array(file)):
        harm()
        for _ in range(2):
            assert torch.equal(draw_bank(images, 50, cache=file), wanted)


def test_a_failed_write_leaves_the_old_file_alone(photos, tmp_path, monkeypatch):
    images, file = photos(h=12, w=14), tmp_path / "bank.npz"
    draw_bank(images, 50, cache=file)
    before = file.read_bytes()

    def full(file):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="Make room, and run"):
        draw_bank(images, 60, cache=file)
    assert file.read_bytes() == before and os.listdir(tmp_path) == ["bank.npz"]


def test_what_no_bank_can_be_drawn_from_is_refused():
    for images, settings, error, says in (
        (torch.rand(1, 3, 4, 9), {}, ValueError, "at least 5 x 5"),
        (torch.rand(0, 3, 9, 9), {}, ValueError, "got none"),
        ([], {}, ValueError, "got none"),
        ([torch.rand(3, 9, 9)], {}, ValueError, "images must"),
        (torch.zeros(1, 3, 9, 9, dtype=torch.uint8), {}, TypeError, "floating point"),
        (torch.rand(1, 3, 9, 9), {"patches": 0}, ValueError, "at least 1"),
        (torch.rand(1, 3, 9, 9), {"overlap": 3}, ValueError, "half of patch"),
        (torch.rand(1, 3, 9, 9), {"seed": -1}, ValueError, "seed must"),
        (torch.rand(1, 3, 9, 9), {"cache": "."}, ValueError, "must be a file"),
    ):
        with pytest.raises(error, match=says):
            quilting_of(images, **{"patches": 10, **settings})


def test_numpys_numbers_count_and_others_may_read_the_file(photos, tmp_path):
    images, file = photos(), tmp_path / "bank.npz"
    wanted = draw_bank(images, 20, patch=4, seed=3)
    numbers = {"patches": np.int64(20), "patch": np.uint8(4), "seed": np.int32(3)}
    assert torch.equal(draw_bank(images, **numbers, cache=file), wanted)
    plain = tmp_path / "plain"
    plain.touch()
    assert file.stat().st_mode == plain.stat().st_mode  # others may read it
