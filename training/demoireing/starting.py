"""Where training starts: a short one should not first have to learn what an image is."""

from __future__ import annotations

import torch
from torch import nn

from moireaug.defenses.demoire import DemoireNet
from moireaug.defenses.demoire.esdnet import DenseBlock, ESDNet

PLANES = 12  # of half size, which make up an image


@torch.no_grad()
def start_as_identity(network: DemoireNet) -> bool:
    """Change the fresh weights of an ESDNet so that its finest prediction is the image itself.

    The image's twelve planes of half size pass the finest level alone, where no block adds anything
    yet; all other weights stay as they were drawn. The other networks add what they predict to the
    image, and need no such start.

    Returns:
        Whether anything was changed: not in another network, nor below width 0.25, where there are
        fewer than twelve channels.
    """
    if not isinstance(network, ESDNet):
        return False
    passing = (network.head, network.merges[0], network.tails[0])
    convolutions = [_convolution(module) for module in passing]
    if any(min(conv.weight.shape[:2]) < PLANES for conv in convolutions):
        return False
    for level in (network.encoders[0], network.decoders[0]):
        for block in level.modules():
            if isinstance(block, DenseBlock):
                for weights in block.fuse.parameters():
                    nn.init.zeros_(weights)
    for conv in convolutions:
        centre = conv.kernel_size[0] // 2
        conv.weight[:PLANES] = 0
        conv.weight[range(PLANES), range(PLANES), centre, centre] = 1
        conv.bias[:PLANES] = 0  # type: ignore[index]
    return True


def _convolution(module: nn.Module) -> nn.Conv2d:
    """Return the first convolution in a module."""
    return next(layer for layer in module.modules() if isinstance(layer, nn.Conv2d))
