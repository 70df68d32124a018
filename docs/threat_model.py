"""Print the tables of threat_model.md: how far noise on the raw reading moves the photo's codes.

Run it as `python docs/threat_model.py`: a minute on one core.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from moireaug import Develop, Panel, Scene, Sensor, attacks, capture, expose
from moireaug.attacks.bounds import BOUNDS, bound_on_reading
from moireaug.camera import pipeline
from moireaug.camera.effects.srgb import codes_of_light
from moireaug.evaluation.visibility import psnr
from training.data import signs

CODES = torch.tensor([0, 128, 255])
# a panel and a sensor that change nothing: what is left is the camera's transfer curve
LINEAR = Scene(
    panel=Panel(layout="even"), sensor=Sensor(cfa="none"), develop=Develop(linear_light=True)
)
SCENES = ("screen_photo", "dashcam_at_led_sign")
EPS = 4 / 255
N_SIGNS, SIDE = 48, 48
N_TRAINING, EPOCHS = 2000, 8
ATTACK_STEPS = 15
# effects after which the change of the codes is printed
STAGES = ("balance", "colour_matrix", "tone_curve", "sharpen")


def signed_noise(reading: Tensor, signs: Tensor, eps: float, bound: str, scene: Scene) -> Tensor:
    """Return noise of these signs at the bound, of the shape of the reading."""
    return bound_on_reading(eps, bound, scene).box(reading).noise(eps * signs)


def curve(eps: float, bound: str) -> list[float]:
    """Return the largest change of each code, of 255, by noise of either sign at the bound."""
    images = (CODES / 255)[:, None, None, None].expand(-1, 3, 4, 4).contiguous()
    shot = LINEAR.sample(len(CODES), (4, 4), torch.Generator().manual_seed(0))
    reading = expose(images, shot)
    moved = []
    for sign in (1.0, -1.0):
        noise = signed_noise(reading, torch.full_like(reading, sign), eps, bound, LINEAR)
        moved.append((capture(images, shot, noise) - images).abs().amax((1, 2, 3)))
    return (255 * torch.stack(moved).amax(0)).tolist()


def stages(images: Tensor, scene: Scene, bound: str) -> dict[str, tuple[float, float, float]]:
    """Return the largest and the RMS change of a code, of 255, by noise of random signs at the
    bound, means over the images, and the largest in any image, in the reading and after each of
    `STAGES`."""
    g = torch.Generator().manual_seed(0)
    shot = scene.sample(len(images), images.shape[-2:], g)
    reading = expose(images, shot)
    random_signs = torch.randint(0, 2, reading.shape, generator=g) * 2.0 - 1
    noisy = reading + signed_noise(reading, random_signs, EPS, bound, scene)
    names, changes = shot.plan.developing, {"reading": _change(reading, noisy, is_light=True)}
    for name in STAGES:
        done = names[: names.index(name) + 1]
        plain, other = (pipeline.apply(done, values, shot) for values in (reading, noisy))
        changes[name] = _change(plain, other, is_light="encode" not in done)
    return changes


def _change(plain: Tensor, other: Tensor, *, is_light: bool) -> tuple[float, float, float]:
    if is_light:
        plain, other = codes_of_light(plain), codes_of_light(other)
    change = 255 * (plain.clamp(0, 1) - other.clamp(0, 1))
    largest = change.abs().amax((1, 2, 3))
    rms = change.square().mean((1, 2, 3)).sqrt().mean()
    return largest.mean().item(), rms.item(), largest.max().item()


def plain_network(images: Tensor, labels: Tensor) -> nn.Module:
    """Return a small network that has learnt photos of images (N, 3, H, W) in both scenes."""
    torch.manual_seed(0)
    layers: list[nn.Module] = []
    for inputs, outputs in ((3, 32), (32, 64), (64, 128)):
        layers += [nn.Conv2d(inputs, outputs, 3, 2, 1), nn.BatchNorm2d(outputs), nn.ReLU()]
    network = nn.Sequential(*layers, nn.AdaptiveAvgPool2d(4), nn.Flatten())
    network.append(nn.Linear(128 * 16, len(signs.CLASSES)))
    optimizer = torch.optim.AdamW(network.parameters(), lr=3e-3, weight_decay=0.05)
    size = images.shape[-2], images.shape[-1]
    for epoch in range(EPOCHS):
        scene = Scene.preset(SCENES[epoch % len(SCENES)])
        for rows in torch.randperm(len(images)).split(64):
            optimizer.zero_grad()
            photos = capture(images[rows], scene.sample(len(rows), size))
            F.cross_entropy(network(photos), labels[rows]).backward()
            optimizer.step()
    return network.eval()


def attacked(
    model: nn.Module, images: Tensor, labels: Tensor, scene: Scene, eps: float, bound: str
) -> tuple[float, float, float]:
    """Return the share of images that are right under the Moiré Attack, the largest change of a
    code, of 255, and the PSNR in dB of its noise in the photo, means over the images."""
    shot = scene.sample(len(images), images.shape[-2:], torch.Generator().manual_seed(0))
    attack = attacks.MoireAttack(model, scene=scene, eps=eps, steps=ATTACK_STEPS, bound=bound)
    result, photos = attack(images, labels, shot=shot), capture(images, shot)
    right = 1 - result.success.float().mean().item()
    largest = (result.images - photos).abs().amax((1, 2, 3)).mean().item()
    return right, 255 * largest, psnr(result.images, photos).mean().item()


def main() -> None:
    for bound in BOUNDS:
        for size in (2, 4, 8):
            black, grey, white = curve(size / 255, bound)
            print(f"{size}/255 in {bound}: 0 by {black:.1f}, 128 by {grey:.1f}, 255 by {white:.1f}")
    pictures, labels = signs.make("test", N_SIGNS, SIDE)
    images = pictures.float() / 255
    for name in SCENES:
        for bound in BOUNDS:
            changes = stages(images, Scene.preset(name), bound)
            texts = [f"{k} {mean:.1f} ({rms:.1f})" for k, (mean, rms, _) in changes.items()]
            worst = changes[STAGES[-1]][2]
            print(f"{name}, random 4/255 in {bound}, largest (RMS): {', '.join(texts)}")
            print(f"  in the worst photo {worst:.1f}")
    training_pictures, training_labels = signs.make("train", N_TRAINING, SIDE)
    model = plain_network(training_pictures.float() / 255, training_labels)
    for name in SCENES:
        for size, bound in ((4, "codes"), (8, "codes"), (16, "codes"), (4, "light")):
            scene = Scene.preset(name)
            right, largest, db = attacked(model, images, labels, scene, size / 255, bound)
            print(
                f"{name}, Moiré Attack {size}/255 in {bound}: {right:.0%} right, "
                f"{largest:.1f} codes, {db:.1f} dB"
            )


if __name__ == "__main__":
    main()
