"""The checks: a sound model passes them, and whatever they warn of makes them fail."""

import dataclasses
import re

import pytest
import torch
from torch import nn

from moireaug import Lens, Panel, Scene, Sensor, View
from moireaug.evaluation import SUITES, SuiteConfig, checks, rates

from .haze import frame_of

SCENE = Scene(
    panel=Panel(scale=1.1),
    view=View(roll=(-5, 5)),
    lens=Lens(blur=0.3),
    sensor=Sensor(scale=2.0, gain=2.4),
)


def verdicts(model, batch, eps=24 / 255, steps=10, scene=SCENE, targets=()):
    config = SuiteConfig(scene=scene, eps=(eps,), steps=steps, targets=dict(targets))
    table = SUITES["trust"](config)
    images = frame_of((model, [batch]), table, seed=1, scene=scene)
    results = checks(config, images, rates(images))
    order = [("fail", "warning", "pass").index(result.verdict) for result in results]
    assert order == sorted(order)
    return {result.name: result for result in results}


CONVERGED = "more steps and restarts change nothing"
GROWS = "success grows with eps, to all images at eps 1"
HIDDEN, BLIND = "gradients are not hidden", "a search without gradients does not win"
SETTLED, ROOM = "the model answers the same twice", "the photo leaves something to attack"


class Pooled(nn.Module):
    """Weighs the colours of sixteen fields: each image has its own margin."""

    def __init__(self, seed=1):
        super().__init__()
        self.pool, self.head = nn.AdaptiveAvgPool2d(4), nn.Linear(48, 4)
        g = torch.Generator().manual_seed(seed)
        with torch.no_grad():
            self.head.weight.copy_(torch.randn(4, 48, generator=g))
            self.head.bias.copy_(-0.5 * self.head.weight.sum(1))

    def forward(self, x):
        return self.head(self.pool(x).flatten(1))


def labelled(model, n=24):
    """Images, and what the model says of them."""
    g = torch.Generator().manual_seed(2)
    fields = 0.2 + 0.6 * torch.rand(n, 3, 4, 4, generator=g)
    images = fields.repeat_interleave(4, 2).repeat_interleave(4, 3)
    with torch.no_grad():
        return images, model(images).argmax(1)


def test_a_sound_model_passes_every_check():
    model = Pooled()
    found = verdicts(model, labelled(model), eps=40 / 255, targets={"twin": Pooled(2)})
    assert {c.verdict for c in found.values()} == {"pass"}, found
    assert "twin" in found["white box, then transfer, then random noise"].says


def through(change):
    """A model that changes its images before the network."""
    net = Pooled()
    return lambda x: net(change(x))


def test_hidden_gradients_are_found():
    model = through(lambda x: (x * 8).round() / 8)
    found = verdicts(model, labelled(model), eps=40 / 255)
    assert found[HIDDEN].verdict == "fail" and "100.0 %" in found[HIDDEN].says
    assert found[BLIND].verdict == "fail", found[BLIND].says


def test_too_few_steps_are_found():
    """One step's direction is soon wrong, and many steps that are one do not beat it."""
    model = through(lambda x: 0.5 + 0.5 * torch.sin(6 * torch.pi * x))
    found = verdicts(model, labelled(model), eps=60 / 255, steps=1)
    assert found[CONVERGED].verdict == "fail", found[CONVERGED].says
    assert found["many steps beat one"].verdict == "warning"


@pytest.mark.parametrize(("size", "verdict"), [(0.05, "warning"), (1e-6, "pass")])
def test_a_randomised_model_is_noticed_but_rounding_is_not(size, verdict):
    model = through(lambda x: x + size * torch.rand(x.shape))
    assert verdicts(model, labelled(model), steps=1)[SETTLED].verdict == verdict


def test_an_attack_that_cannot_win_is_noticed():
    """A model of one answer has nothing to attack: success stays 0 at eps 1."""

    def stubborn(x):
        return torch.tensor([[0.0, 9.0, 0.0]]).repeat(len(x), 1) + 0 * x.mean()

    images, _ = labelled(Pooled())
    found = verdicts(stubborn, (images, torch.ones(len(images), dtype=torch.long)), steps=2)
    assert found[GROWS].verdict == "fail" and found[HIDDEN].verdict == "fail"


def test_a_scene_that_fools_by_itself_leaves_no_room():
    def contrast(x):
        """Any texture changes its answer."""
        rough = (x[..., 1:] - x[..., :-1]).abs().mean((1, 2, 3))
        return torch.stack([0.02 - rough, rough - 0.02], 1)

    smooth = torch.full((4, 3, 16, 16), 0.5), torch.zeros(4, dtype=torch.long)
    even = Scene(panel=Panel(layout="even"))
    for scene, verdict in ((Scene.preset("paper_code"), "warning"), (even, "pass")):
        assert verdicts(contrast, smooth, scene=scene, steps=1)[ROOM].verdict == verdict


def test_a_weaker_target_does_not_fail_a_sound_model():
    def fragile(x):
        """Right when clean, and thrown by any photo."""
        is_clean = (x == images[: len(x)]).flatten(1).all(1)
        return model(x) * torch.where(is_clean, 1.0, -1.0)[:, None]

    model = Pooled()
    images, labels = labelled(model)
    found = verdicts(model, (images, labels), eps=2 / 255, steps=4, targets={"fragile": fragile})
    assert found["white box, then transfer, then random noise"].verdict != "fail"


def test_nothing_right_leaves_nothing_to_check():
    model = Pooled()
    images, labels = labelled(model)
    (check,) = verdicts(model, (images, (labels + 1) % 4), steps=1).values()
    assert check.verdict == "warning" and "0 % of the images are right" in check.says


@pytest.mark.parametrize(("eps", "sizes"), [(0.6, ["76.5", "153", "255"]), (1, ["127.5", "255"])])
def test_any_bound_can_be_checked(eps, sizes):
    """Half of it, twice as much and 1, each once and none above 1."""
    model = Pooled()
    says = verdicts(model, labelled(model), eps=eps, steps=1)[GROWS].says
    assert re.findall(r"at ([\d.]+)/255", says) == sizes


def test_checks_of_another_config_are_refused():
    config, model = SuiteConfig(scene=SCENE, eps=(8 / 255,), steps=1), Pooled().eval()
    table = SUITES["trust"](config)
    images = frame_of((model, [labelled(model, 2)]), table, scene=SCENE)
    for change in ({"eps": (16 / 255,)}, {"steps": 2}):
        other = dataclasses.replace(config, **change)
        with pytest.raises(ValueError, match=r"; got \{'eps_4': 1, 'eps_8': 1, "):
            checks(other, images, rates(images))
    images = images.assign(table="ladder")
    with pytest.raises(ValueError, match=r"; got \{\}"):
        checks(config, images, rates(images))
