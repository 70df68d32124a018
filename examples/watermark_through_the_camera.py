"""Put the capture inside your own network, as a differentiable layer.

A watermark is learnt end to end, as in StegaStamp (Tancik et al., CVPR 2020) and PIMoG (Fang et
al., ACM Multimedia 2022): an encoder hides bits in an image, the image is photographed off a
screen, and a decoder reads the photo. The decoder's gradient reaches the encoder through the
camera. Trained without a camera, the mark does not survive a photo.

    python examples/watermark_through_the_camera.py

Prints the share of bits read from marked images and from photos of them, and the mark's PSNR.
"""

import argparse
import sys
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from moireaug import Develop, Lens, Panel, Scene, Sensor, View
from moireaug.nn import ScreenCamera

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the repository, for `training`

from training.data import signs

BITS, STRENGTH, SIDE = 16, 0.06, 32
SCENE = Scene(
    panel=Panel(scale=(1.0, 1.3)), view=View(yaw=(-10, 10), roll=(-4, 4)), lens=Lens(blur=0.5),
    sensor=Sensor(gain=2.8, read_noise=0.005), develop=Develop(linear_light=True),
)  # fmt: skip


class Encoder(nn.Module):
    """Hide bits (B, BITS) in images (B, 3, SIDE, SIDE) by at most STRENGTH per value."""

    def __init__(self) -> None:
        super().__init__()
        self.spread = nn.Linear(BITS, 3 * SIDE * SIDE)
        self.blend = nn.Sequential(nn.Conv2d(6, 16, 3, 1, 1), nn.ReLU(), nn.Conv2d(16, 3, 3, 1, 1))

    def forward(self, images: Tensor, bits: Tensor) -> Tensor:
        pattern = self.spread(2 * bits - 1).view_as(images)
        mark = pattern + self.blend(torch.cat([images, pattern], 1))
        return (images + STRENGTH * mark.tanh()).clamp(0, 1)


def train(camera, images: Tensor, steps: int) -> tuple[nn.Module, nn.Module]:
    """Train an encoder and a decoder with a camera between them."""
    features = [nn.Conv2d(3, 32, 3, 2, 1), nn.ReLU(), nn.Conv2d(32, 64, 3, 2, 1), nn.ReLU()]
    head = nn.Linear(64 * (SIDE // 4) ** 2, BITS)
    encoder, decoder = Encoder(), nn.Sequential(*features, nn.Flatten(), head)
    optimizer = torch.optim.Adam(nn.ModuleList([encoder, decoder]).parameters(), lr=2e-3)
    for _ in range(steps):
        shown = images[torch.randint(len(images), (8,))]
        bits = torch.randint(0, 2, (8, BITS)).float()
        logits = decoder(camera(encoder(shown, bits)))
        optimizer.zero_grad()
        F.binary_cross_entropy_with_logits(logits, bits).backward()
        optimizer.step()
    return encoder, decoder


def main() -> None:
    """Train with and without the camera, and read both kinds of marks."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=500)
    args = parser.parse_args()
    torch.manual_seed(0)
    images = signs.make("train", 364, SIDE)[0].float() / 255
    test, bits = images[:64], torch.randint(0, 2, (64, BITS)).float()
    screen = ScreenCamera(SCENE, jitter=0.5)
    for name, camera in {"no camera": nn.Identity(), "the camera": screen}.items():
        encoder, decoder = train(camera, images[64:], args.steps)
        with torch.no_grad():
            marked = encoder(test, bits)
            photos = screen(marked)
            read = [((decoder(x) > 0) == bits).float().mean() for x in (marked, photos)]
        psnr = -10 * F.mse_loss(marked, test).log10()
        print(f"{name}: {read[0]:.0%} read in images, {read[1]:.0%} in photos, {psnr:.0f} dB")


if __name__ == "__main__":
    main()
