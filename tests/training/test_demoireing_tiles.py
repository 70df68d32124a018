"""Pictures in tiles: exact where a network sees no farther than the tiles overlap."""

import torch
from torch import nn

from moireaug.defenses import demoire
from training.demoireing.tiles import TILE_OVERLAP, TILE_SIDE, spans, tiled


def near_sighted(radius):
    """A network whose every pixel depends on those up to `radius` away, and on no others."""
    torch.manual_seed(3)
    convs = [nn.Conv2d(3, 3, 3, padding=1) for _ in range(radius)]
    return nn.Sequential(*convs).double().eval()


@torch.no_grad()
def test_tiles_are_exact_within_a_quarter_of_their_overlap():
    network = near_sighted(4)
    for size in ((64, 64), (65, 64), (40, 200), (150, 97), (111, 129), (1, 300), (64, 112)):
        images = torch.rand(2, 3, *size, dtype=torch.float64)
        found = tiled(network, images, side=64, overlap=16)
        assert (found - network(images)).abs().max() < 1e-12, size


@torch.no_grad()
def test_what_is_seen_farther_off_is_not():
    network, images = near_sighted(12), torch.rand(1, 3, 150, 97, dtype=torch.float64)
    found = tiled(network, images, side=64, overlap=16)
    assert (found - network(images)).abs().max() > 1e-9


@torch.no_grad()
def test_no_tile_is_too_long_or_a_sliver():
    sizes = []

    def watched(images):
        sizes.append(tuple(images.shape[-2:]))
        return images

    images = torch.rand(1, 3, 770, 1300)
    torch.testing.assert_close(tiled(watched, images, side=256, overlap=64), images)
    assert max(map(max, sizes)) <= 256 and min(map(min, sizes)) > 256 - 32


def test_every_tile_lies_on_its_networks_grid():
    for name, network in demoire.NETWORKS.items():
        for length in range(TILE_SIDE + 1, 3 * TILE_SIDE, 5):
            starts = [start for start, _ in spans(length, TILE_SIDE, TILE_OVERLAP)]
            assert not any(start % network.multiple for start in starts), (name, length)


@torch.no_grad()
def test_a_network_finds_nearly_the_same_in_tiles():
    network = demoire.build("esdnet", width=0.125).eval()
    images = torch.rand(1, 3, 224, 96)
    whole, found = network(images), tiled(network, images, side=160, overlap=64)
    away = torch.ones(224, dtype=torch.bool)
    away[64:192] = False  # where tiles meet
    assert (found - whole).abs().mean() < 0.1 * (whole - whole.mean()).abs().mean()
    assert (found - whole)[..., away, :].abs().max() < 0.05
