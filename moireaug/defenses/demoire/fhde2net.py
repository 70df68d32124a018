"""FHDe2Net (He et al., "FHDe²Net: Full High Definition Demoireing Network", ECCV 2020)."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from moireaug.common.numeric import LUMA_WEIGHTS
from moireaug.defenses.demoire.base import DemoireNet, scaled
from moireaug.defenses.demoire.layers import Residual, UNet, conv, resized

GLOBAL_CHANNELS = (52, 104, 208, 416)  # channels of the levels of GDN, and of LRN
FUSION_CHANNELS = (36, 72, 144, 288)  # of FRN
SPECTRAL_CHANNELS, SPECTRAL_BLOCKS = 98, 4  # channels and residual blocks of FDN
GDN_REDUCTION = 4  # factor by which the image that GDN sees is reduced
DCT_SIDE = 8  # of the blocks of the cosine transform, in pixels


class FHDe2Net(DemoireNet):
    """Four networks: the global demoiréing network (GDN) removes coarse moiré from a reduced image,
    the local refinement network (LRN) goes on at full size, the frequency domain network (FDN)
    keeps the fine content of the photo's luminance, and the fusion refinement network (FRN) puts
    both together.

    Source: the global to local cascade, and the separation of content by frequency. The paper's
    layer counts were not available. Chosen here, to agree with the published 5.2, 5.1, 0.8 and 2.5
    million parameters: GDN, LRN and FRN are encoders and decoders of four levels that predict what
    to change, GDN sees the image at a quarter of its size, and FDN is four residual blocks on the
    64 coefficients of 8 x 8 block cosine transforms.

    `outputs` are the image, LRN's and, at quarter size, GDN's.
    """

    name = "fhde2net"
    multiple = GDN_REDUCTION * 2 ** (len(GLOBAL_CHANNELS) - 1)

    def __init__(self, width: float = 1.0) -> None:
        super().__init__(width)
        deep = [scaled(channels, width) for channels in GLOBAL_CHANNELS]
        fusion = [scaled(channels, width) for channels in FUSION_CHANNELS]
        self.gdn = UNet(3, 3, deep)
        self.lrn = UNet(6, 3, deep)
        self.fdn = Spectral(scaled(SPECTRAL_CHANNELS, width))
        self.frn = UNet(4, 3, fusion)

    def predict(self, images: Tensor) -> tuple[Tensor, ...]:
        small = F.avg_pool2d(images, GDN_REDUCTION)
        coarse = small + self.gdn(small)
        start = images + resized(coarse - small, images)
        refined = start + self.lrn(torch.cat([images, start], 1))
        content = self.fdn(images)
        final = refined + self.frn(torch.cat([refined, content], 1))
        return final, refined, coarse


class Spectral(nn.Module):
    """Convolutions on the coefficients, one a channel, of block cosine transforms of the luminance:
    images (B, 3, H, W) to the luminance's content (B, 1, H, W); sides are multiples of 8."""

    basis: Tensor
    luminance: Tensor

    def __init__(self, channels: int) -> None:
        super().__init__()
        layers: list[nn.Module] = [conv(DCT_SIDE**2, channels)]
        for _ in range(SPECTRAL_BLOCKS):
            last = nn.Conv2d(channels, channels, 3, padding=1)
            layers.append(Residual(nn.Sequential(conv(channels, channels), last)))
        layers.append(nn.Conv2d(channels, DCT_SIDE**2, 3, padding=1))
        self.body = nn.Sequential(*layers)
        self.register_buffer("basis", cosines(), persistent=False)
        weights = torch.tensor(LUMA_WEIGHTS).view(1, 3, 1, 1)
        self.register_buffer("luminance", weights, persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        grey = F.conv2d(images, self.luminance)
        coefficients = F.conv2d(grey, self.basis, stride=DCT_SIDE)
        coefficients = coefficients + self.body(coefficients)
        return F.conv_transpose2d(coefficients, self.basis, stride=DCT_SIDE)


def cosines() -> Tensor:
    """Return the orthonormal DCT-II of 8 x 8 blocks as kernels (64, 1, 8, 8), of the dtype and on
    the device that new weights have."""
    place = torch.arange(DCT_SIDE, dtype=torch.float64)
    rows = torch.cos(math.pi / DCT_SIDE * (place + 0.5) * place[:, None]) * math.sqrt(2 / DCT_SIDE)
    rows[0] /= math.sqrt(2)
    basis = torch.einsum("iy,jx->ijyx", rows, rows)
    return basis.reshape(DCT_SIDE**2, 1, DCT_SIDE, DCT_SIDE).to(torch.get_default_dtype())
