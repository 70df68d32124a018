"""Attacks find what there is to find: closed forms, and models broken by construction."""

import itertools

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, attacks, capture
from moireaug.attacks import ATTACKS, RULES, MoireAttack
from tests.attacks.common import EPS, SCENE, predicted


def test_a_linear_model_is_attacked_optimally():
    """margin(delta) - margin(0) = eps * ||A^T w||_1, reached exactly where nothing is clipped."""
    scene = Scene(
        panel=Panel(scale=1.1),
        view=View(roll=3.0),
        lens=Lens(blur=0.3),
        sensor=Sensor(scale=2.0),
        develop=Develop(brighten=0.2),
    )
    images = torch.rand(3, 3, 8, 8, dtype=torch.float64) * 0.5 + 0.3
    g, labels = torch.Generator().manual_seed(9), torch.tensor([0, 1, 0])
    weight = torch.randn(2, 3 * 8 * 8, generator=g, dtype=torch.float64)

    def model(x):
        return x.flatten(1) @ weight.T

    shot = scene.sample(3, (8, 8))
    noise = torch.zeros(shot.raw_shape(), dtype=torch.float64, requires_grad=True)
    before = attacks.margin(model(capture(images, shot, noise)), labels)
    (slope,) = torch.autograd.grad(before.sum(), noise)
    best = before + EPS * slope.abs().sum((1, 2, 3))
    assert (best > before + 1e-3).all()
    for case in itertools.product((1, 5), ("ce", "margin"), ("sign", "momentum", "apgd")):
        steps, loss, rule = case
        attack = MoireAttack(model, scene=scene, eps=EPS, steps=steps, loss=loss, rule=rule)
        result = attack(images, labels, shot=shot)
        assert torch.allclose(attacks.margin(model(result.images), labels), best, rtol=1e-9), case


def test_a_model_broken_by_construction_is_broken():
    """Its decision hangs on a difference far below eps."""

    def model(x):
        left, right = x[..., :8].mean((1, 2, 3)), x[..., 8:].mean((1, 2, 3))
        return torch.stack([left, right], 1) * 1e4

    images = torch.full((8, 3, 16, 16), 0.5)
    images[:4, ..., :8] += 0.002
    images[4:, ..., 8:] += 0.002
    scene = Scene(lens=Lens(blur=2.0), sensor=Sensor(scale=2.0, gain=3.0))
    labels = predicted(model, scene.capture(images))
    assert labels.tolist() == [0] * 4 + [1] * 4
    settings = [{"rule": rule, "loss": loss} for rule in RULES for loss in ("ce", "margin")]
    for setting in (*settings, {"noise_at": "photo"}):
        attack = MoireAttack(model=model, scene=scene, eps=EPS, steps=5, **setting)
        for targets in (None, 1 - labels):
            assert attack(images, labels, targets).success.all(), setting
    # and what it cannot reach, it does not claim
    beyond = MoireAttack(model, scene=scene, eps=1e-7, steps=5)
    assert not beyond(images, labels).success.any()


def brightness(x):
    """Three classes, by the mean of the image and how far it lies from what it was trained on."""
    x = (x.mean((1, 2, 3)) - 0.5) * 100
    return torch.stack([x, -x, -x.abs() - 9], 1)


def one_pixel(x):
    x = (x[:, 1, 4, 4] - 0.5) * 10
    return torch.stack([x, -x, -x.abs() - 9], 1)


@pytest.mark.parametrize("name", ATTACKS)
@pytest.mark.parametrize("broken", [brightness, one_pixel])
def test_every_attack_breaks_what_is_broken(name, broken):
    """Decisions that hang on one number, which eps moves far enough."""
    images = torch.tensor([0.498, 0.502]).view(2, 1, 1, 1).expand(2, 3, 8, 8).clone()
    labels, settings = torch.tensor([1, 0]), {"steps": 80 if name == "square" else 20}
    if name != "cw":
        settings["eps"] = 0.03
    if name == "patch":
        settings["area"] = 0.5  # a disc that covers the pixel wherever it lies
    if issubclass(ATTACKS[name], MoireAttack):
        # a camera whose photo is the image
        settings["scene"] = Scene(sensor=Sensor(cfa="none", exposure="mean", gain=3.0))
        assert torch.equal(predicted(broken, settings["scene"].capture(images)), labels)
    assert torch.equal(predicted(broken, images), labels)
    attack = ATTACKS[name](broken, **settings)
    for targets in (None, 1 - labels):
        assert attack(images, labels, targets).success.all()


def test_more_eps_never_fools_fewer(learnt_photos):
    model, images, labels, shot = learnt_photos(40)
    curve = []
    for eps in (0, 2 / 255, 8 / 255, 1.0):
        attack = MoireAttack(model=model, scene=SCENE, eps=eps, steps=6)
        curve.append(attack(images, labels, shot=shot))
    rates = [r.success.float().mean().item() for r in curve]
    assert rates == sorted(rates) and rates[-1] == 1.0
    assert torch.allclose(curve[0].images, capture(images, shot), atol=1e-6)
