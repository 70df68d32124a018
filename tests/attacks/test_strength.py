"""Attacks find what there is to find: closed forms, models broken by construction, and more than
random noise does."""

import pytest
import torch
from torch import nn

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, attacks, capture
from moireaug.attacks import ATTACKS, RULES, MoireAttack
from tests.attacks.common import EPS, SCENE, predicted, striped


class Linear(nn.Module):
    """Logits linear in the photo: the worst noise of a ball is known in closed form."""

    def __init__(self, size):
        super().__init__()
        g = torch.Generator().manual_seed(9)
        self.weight = nn.Parameter(
            torch.randn(2, 3 * size * size, generator=g, dtype=torch.float64)
        )

    def forward(self, x):
        return x.flatten(1) @ self.weight.T.to(x)


@pytest.mark.parametrize("rule", ["sign", "momentum", "apgd"])
@pytest.mark.parametrize("loss", ["ce", "margin"])
@pytest.mark.parametrize("steps", [1, 5])
def test_a_linear_model_is_attacked_optimally(loss, steps, rule):
    """margin(delta) - margin(0) = eps * ||A^T w||_1, reached exactly, as long as nothing is
    clipped."""
    scene = Scene(
        panel=Panel(scale=1.1),
        view=View(roll=3.0),
        lens=Lens(blur=0.3),
        sensor=Sensor(scale=2.0),
        develop=Develop(brighten=0.2),
    )
    images = torch.rand(3, 3, 8, 8, dtype=torch.float64) * 0.5 + 0.3
    model, labels = Linear(8), torch.tensor([0, 1, 0])
    shot = scene.sample(3, (8, 8))
    noise = torch.zeros(shot.raw_shape(), dtype=torch.float64, requires_grad=True)
    before = attacks.margin(model(capture(images, shot, noise)), labels)
    (slope,) = torch.autograd.grad(before.sum(), noise)
    best = before + EPS * slope.abs().sum((1, 2, 3))
    result = MoireAttack(model=model, scene=scene, eps=EPS, steps=steps, loss=loss, rule=rule)(
        images, labels, shot=shot
    )
    reached = attacks.margin(model(result.images), labels)
    assert torch.allclose(reached, best, rtol=1e-9)
    assert (reached > before + 1e-3).all()


def test_a_model_broken_by_construction_is_broken():
    """Its decision hangs on a difference far below eps: an attack that cannot flip it is a broken
    attack."""

    class Fragile(nn.Module):
        def forward(self, x):
            left, right = x[..., :8].mean((1, 2, 3)), x[..., 8:].mean((1, 2, 3))
            return torch.stack([left, right], 1) * 1e4

    images = torch.full((8, 3, 16, 16), 0.5)
    images[:4, ..., :8] += 0.002
    images[4:, ..., 8:] += 0.002
    model = Fragile()
    scene = Scene(lens=Lens(blur=2.0), sensor=Sensor(scale=2.0, gain=3.0))
    labels = predicted(model, scene.capture(images))
    assert labels.tolist() == [0] * 4 + [1] * 4
    settings = [{"rule": rule, "loss": loss} for rule in RULES for loss in ("ce", "margin")] + [
        {"noise_at": "photo"}
    ]
    for setting in settings:
        attack = MoireAttack(model=model, scene=scene, eps=EPS, steps=5, **setting)
        for targets in (None, 1 - labels):
            assert attack(images, labels, targets).success.all(), setting
    # and what it cannot reach, it does not claim
    assert not MoireAttack(model=model, scene=scene, eps=1e-7, steps=5)(
        images, labels
    ).success.any()


class Brightness(nn.Module):
    """Three classes, by the mean of the image and how far it lies from what it was trained on."""

    def forward(self, x):
        x = (x.mean((1, 2, 3)) - 0.5) * 100
        return torch.stack([x, -x, -x.abs() - 9], 1)


class OnePixel(nn.Module):
    def forward(self, x):
        x = (x[:, 1, 4, 4] - 0.5) * 10
        return torch.stack([x, -x, -x.abs() - 9], 1)


@pytest.mark.parametrize("name", ATTACKS)
@pytest.mark.parametrize("broken", [Brightness, OnePixel])
@pytest.mark.parametrize("targeted", [False, True])
def test_every_attack_breaks_what_is_broken(name, broken, targeted):
    """Decisions that hang on one number, which eps moves far enough; gradient or none, each attack
    must find it."""
    images = torch.tensor([0.498, 0.502]).view(2, 1, 1, 1).expand(2, 3, 8, 8).clone()
    labels, settings = torch.tensor([1, 0]), {"steps": 20}
    if name != "cw":
        settings["eps"] = 0.03
    if name == "patch":
        settings["area"] = 0.5  # a disc that covers the pixel wherever it lies
    if issubclass(ATTACKS[name], MoireAttack):
        # a camera whose photo is the image
        settings["scene"] = Scene(sensor=Sensor(cfa="none", exposure="mean", gain=3.0))
        assert torch.equal(predicted(broken(), settings["scene"].capture(images)), labels)
    assert torch.equal(predicted(broken(), images), labels)
    result = ATTACKS[name](broken(), **settings)(images, labels, 1 - labels if targeted else None)
    assert result.success.all()


def test_the_attack_beats_random_noise(trained):
    g = torch.Generator().manual_seed(0)
    images, labels = striped(64, g)
    shot = SCENE.sample(len(images), (16, 16))
    model = trained(capture(images, shot), labels)
    signs = torch.randint(0, 2, shot.raw_shape(), generator=g) * 2.0 - 1
    result = MoireAttack(model=model, scene=SCENE, eps=EPS, steps=10)(images, labels, shot=shot)
    fooled = (predicted(model, capture(images, shot, EPS * signs)) != labels).float().mean()
    assert result.success.float().mean() > fooled + 0.2
    assert result.loss[-1] > result.loss[0]


def test_more_eps_never_fools_fewer(trained):
    g = torch.Generator().manual_seed(0)
    images, labels = torch.rand(40, 3, 16, 16, generator=g), torch.arange(40) % 5
    shot = SCENE.sample(len(images), (16, 16))
    model = trained(capture(images, shot), labels)
    curve = []
    for eps in (0, 2 / 255, 8 / 255, 1.0):
        attack = MoireAttack(model=model, scene=SCENE, eps=eps, steps=10)
        curve.append(attack(images, labels, shot=shot))
    rates = [r.success.float().mean().item() for r in curve]
    assert rates == sorted(rates) and rates[-1] == 1.0
    assert torch.allclose(curve[0].images, capture(images, shot), atol=1e-6)
