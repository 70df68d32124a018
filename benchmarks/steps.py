"""What a step through the camera costs, of attacks and of training, beside one without it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
import torch.nn.functional as F
from hydra import initialize
from torch import Tensor
from torchvision.models import resnet18

from benchmarks import training_steps
from benchmarks.measure import timed_together
from benchmarks.rows import Row, Size, time_row
from moireaug import attacks


def attack_step(size: Size) -> Iterator[Row]:
    """Yield a step of the Moiré Attack against one of PGD on pixels: forward, backward, update."""
    images, labels = size.images(), torch.zeros(size.batch, dtype=torch.long)
    model = resnet18(weights=None).eval()
    ours = attacks.MoireAttack(model, scene="screen_photo")
    steps = {"moire": step(ours, images, labels), "pgd": step(attacks.PGD(model), images, labels)}
    times = timed_together(steps, 2 * size.slow)
    yield time_row(
        "a Moiré Attack step, ResNet-18",
        times["moire"],
        "a PGD step",
        times["pgd"],
        bar=1.03,
        stretch=1.01,
    )


def step(attack: attacks.Attack, images: Tensor, labels: Tensor) -> Callable[[], Tensor]:
    """Return a step as in the attacks' loop, on a problem that is set up once for all steps."""
    shot = attack.draw(images, None, None)
    problem, eps = attack.problem(images, shot, None), attack.eps
    start = torch.zeros(problem.shape, device=images.device)

    @torch.enable_grad()
    def run() -> Tensor:
        noise = start.clone().requires_grad_(True)
        photos = problem.forward_views({"noise": noise})
        loss = F.cross_entropy(attack.model(photos), labels, reduction="sum")
        (gradient,) = torch.autograd.grad(loss, noise)
        return (noise.detach() + eps / 4 * gradient.sign()).clamp(-eps, eps)

    return run


def training(size: Size) -> Iterator[Row]:
    """Yield a step of adversarial training through the camera beside one on pixels."""
    batch, side = size.training
    with initialize(version_base="1.3", config_path=None), torch.enable_grad():
        calls = {}
        for name in ("moire_at", "pgd_at"):
            cfg = training_steps.configure(f"recipe={name}", "model=small_resnet")
            calls[name] = training_steps.step(cfg, batch, side)
        times = timed_together(calls, 2 * size.slow)
    what = f"a moire_at step, small_resnet, {batch} of {side} px"
    yield time_row(what, times["moire_at"], "a pgd_at step", times["pgd_at"], bar=1.25, stretch=1.1)
