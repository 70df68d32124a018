"""Initial weights: a short training should not have to learn first what an image is."""

import torch
from torch import nn

from moireaug.defenses.demoire import DemoireNet
from moireaug.defenses.demoire.amnet import AMNet
from moireaug.defenses.demoire.esdnet import DenseBlock, ESDNet

PLANES = 12  # of half size, which make up an image


@torch.no_grad()
def start_as_identity(network: DemoireNet) -> bool:
    """Change the fresh weights of an ESDNet or AMNet so that it predicts the image itself.

    In an ESDNet, twelve channels of each level pass the planes of half size that make up the image
    at its scale, and no block adds anything yet; all other weights stay as they were drawn. AMNet's
    last convolutions are zero. The other networks add what they predict to the image.

    Returns:
        Whether anything was changed: not in another network, nor in an ESDNet below width 0.25,
        where there are fewer than twelve channels.
    """
    if isinstance(network, AMNet):
        for last in (network.additive, network.multiplicative):
            _silence(last)
        return True
    return isinstance(network, ESDNet) and _pass_images(network)


def _pass_images(network: ESDNet) -> bool:
    """Start an ESDNet as the identity, if it has enough channels; return whether it has."""
    passing = [_convolution(network.head)]
    for module in (*network.merges, *network.tails):
        passing.append(_convolution(module))
    if any(min(conv.weight.shape[:2]) < PLANES for conv in passing):
        return False
    for level in (*network.encoders, *network.decoders):
        for block in level.modules():
            if isinstance(block, DenseBlock):
                _silence(block.fuse)
    for conv in passing:
        _pass(conv)
    for module in network.downs:
        _halve(_convolution(module))
    return True


def _silence(conv: nn.Conv2d) -> None:
    """Make a convolution return zero."""
    for weights in conv.parameters():
        nn.init.zeros_(weights)


def _pass(conv: nn.Conv2d) -> None:
    """Make a convolution pass its first twelve channels."""
    centre = conv.kernel_size[0] // 2
    conv.weight[:PLANES] = 0
    conv.weight[range(PLANES), range(PLANES), centre, centre] = 1
    conv.bias[:PLANES] = 0  # type: ignore[index]


def _halve(conv: nn.Conv2d) -> None:
    """Make a 3 x 3 convolution of stride 2 turn the planes of an image into those of the image at
    half size: the mean of a colour's four planes is a pixel there."""
    conv.weight[:PLANES] = 0
    conv.bias[:PLANES] = 0  # type: ignore[index]
    for plane in range(PLANES):
        colour, place = divmod(plane, 4)
        down, right = divmod(place, 2)
        conv.weight[plane, 4 * colour : 4 * colour + 4, 1 + down, 1 + right] = 0.25


def _convolution(module: nn.Module) -> nn.Conv2d:
    """Return the first convolution in a module."""
    return next(layer for layer in module.modules() if isinstance(layer, nn.Conv2d))
