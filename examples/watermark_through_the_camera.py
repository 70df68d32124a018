"""Put the capture inside your own network, as a differentiable layer.

An encoder hides 64 bits in images of 128 px, the image is photographed off a screen, and a decoder
reads the photo. The decoder's gradient reaches the encoder through the camera. How other layers do
is in docs/through_the_screen.md.

    python examples/watermark_through_the_camera.py

Prints the share of bits read from marked images and from photos of them, at 30 dB.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from moireaug.nn import ScreenCamera

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the repository, for what follows

from benchmarks.watermark_networks import BITS, SIDE, Decoder, Encoder
from training.data.drawn_pictures import render

PSNR = 30.0  # dB of marked images


def train(camera: nn.Module, images: Tensor, steps: int) -> tuple[Encoder, Decoder]:
    """Train an encoder and a decoder with a camera between them, and ever fainter marks."""
    encoder, decoder = Encoder(), Decoder()
    optimizer = torch.optim.Adam([*encoder.parameters(), *decoder.parameters()], lr=2e-3)
    for step in range(steps):
        shown = images[torch.randint(len(images), (8,))]
        bits = torch.randint(0, 2, (8, BITS)).float()
        photos = camera(encoder(shown, bits, PSNR - 10 * (1 - step / steps)))
        loss = F.binary_cross_entropy_with_logits(decoder(photos), bits)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return encoder, decoder


def main() -> None:
    """Train with and without the camera, and read both kinds of marks."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=400)
    args = parser.parse_args()
    torch.manual_seed(0)
    drawn = [np.array(render(np.random.default_rng(seed), SIDE)[1]) for seed in range(132)]
    images = torch.from_numpy(np.stack(drawn)).permute(0, 3, 1, 2).float() / 255
    test, bits = images[:32], torch.randint(0, 2, (32, BITS)).float()
    screen = ScreenCamera("screen_photo", shrink=(1, 3), jitter=2.0)
    for name, camera in {"no camera": nn.Identity(), "the camera": screen}.items():
        encoder, decoder = train(camera, images[32:], args.steps)
        with torch.no_grad():
            marked = encoder(test, bits, PSNR)
            read = [((decoder(x) > 0) == bits).float().mean() for x in (marked, screen(marked))]
        print(f"{name}: {read[0]:.0%} read in images, {read[1]:.0%} in photos")


if __name__ == "__main__":
    main()
