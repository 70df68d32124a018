"""Put the capture inside a network of your own, as a differentiable layer.

A watermark that survives screen and camera is learnt end to end, as in StegaStamp (Tancik et al.,
CVPR 2020) and PIMoG (Fang et al., ACM Multimedia 2022): an encoder hides bits in an image, the
screen is photographed, and a decoder reads the photo. Its gradient reaches the encoder through the
camera. Both are trained without a camera, too.

    python examples/watermark_through_the_camera.py

Prints the share of bits that are read in marked images and in photos of them, and the mark's PSNR.
"""

import argparse

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from moireaug import Scene
from training import signs

BITS, STRENGTH, SCENE = 16, 0.08, Scene.preset("phone_at_monitor")


def layer(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    """Return a convolution with its activation."""
    return nn.Sequential(nn.Conv2d(inputs, outputs, 3, stride, 1), nn.ReLU())


class Encoder(nn.Module):
    """Hide bits (B, BITS) in images (B, 3, H, W); no value changes by more than STRENGTH."""

    def __init__(self) -> None:
        super().__init__()
        self.spread = nn.Linear(BITS, 8 * 6 * 6)
        self.mark = nn.Sequential(layer(8 + 3, 32), layer(32, 32), nn.Conv2d(32, 3, 3, 1, 1))

    def forward(self, images: Tensor, bits: Tensor) -> Tensor:
        coarse = self.spread(bits - 0.5).unflatten(1, (8, 6, 6))
        pattern = F.interpolate(coarse, images.shape[-2:], mode="bilinear")
        mark = self.mark(torch.cat([images - 0.5, pattern], 1)).tanh()
        return (images + STRENGTH * mark).clamp(0, 1)


def train(camera, images: Tensor, steps: int) -> tuple[nn.Module, nn.Module]:
    """Train an encoder and a decoder with a camera between them."""
    torch.manual_seed(0)
    flat = [nn.AdaptiveAvgPool2d(6), nn.Flatten(), nn.Linear(64 * 36, BITS)]
    encoder, decoder = Encoder(), nn.Sequential(layer(3, 32, 2), layer(32, 64, 2), *flat)
    optimizer = torch.optim.Adam(nn.ModuleList([encoder, decoder]).parameters(), lr=2e-3)
    for _ in range(steps):
        shown = images[torch.randint(len(images), (16,))]
        bits = torch.randint(0, 2, (16, BITS)).float()
        logits = decoder(camera(encoder(shown, bits)))
        optimizer.zero_grad()
        F.binary_cross_entropy_with_logits(logits, bits).backward()
        optimizer.step()
    return encoder, decoder


def main() -> None:
    """Train with and without the camera, and read both kinds of marks."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--images", type=int, default=564, help="of which 64 are not trained on")
    args = parser.parse_args()
    images = signs.make("train", args.images)[0].float() / 255
    test, bits = images[:64], torch.randint(0, 2, (64, BITS)).float()
    for name, camera in {"no camera": nn.Identity(), "the camera": SCENE.capture}.items():
        encoder, decoder = train(camera, images[64:], args.steps)
        with torch.no_grad():
            marked = encoder(test, bits)
            photos = SCENE.capture(marked, torch.Generator().manual_seed(0))
            read = [((decoder(x) > 0) == bits).float().mean() for x in (marked, photos)]
            psnr = -10 * F.mse_loss(marked, test).log10()
        print(f"{name}: {read[0]:.0%} read in images, {read[1]:.0%} in photos, {psnr:.0f} dB")


if __name__ == "__main__":
    main()
