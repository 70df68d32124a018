"""What recipes train on: each one's step and cost, replayed noise, and chosen shots."""

import dataclasses

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from moireaug.attacks import MoireAttack
from moireaug.capture import capture
from moireaug.scene.parts import Panel
from moireaug.scene.scene import Scene
from tests.training.small import TINY, configured
from training.adversaries import Adversaries, Moment, Shown, check, narrowed, passes
from training.batches import Batch
from training.classifier import Classifier
from training.schema import RECIPES, Adversary
from training.train import classifier_of

pytestmark = pytest.mark.usefixtures("as_the_command_is")

SCENE = Scene.preset("screen_photo")


class Counting(nn.Module):
    """A linear classifier that counts the images it sees, with and without gradient."""

    def __init__(self):
        super().__init__()
        torch.manual_seed(0)
        self.head = nn.Linear(3 * 24 * 24, 4)
        self.forwards, self.backwards = 0, 0

    def forward(self, x):
        self.forwards += len(x)
        if x.requires_grad:
            n = len(x)
            x.register_hook(lambda g: setattr(self, "backwards", self.backwards + n))
        return self.head(x.flatten(1))


def batch(n=4):
    g = torch.Generator().manual_seed(1)
    return torch.rand(n, 3, 24, 24, generator=g), torch.arange(n) % 4


@pytest.mark.parametrize("recipe", [p.stem for p in RECIPES.glob("*.yaml")])
def test_every_recipe_turns_images_into_images(recipe):
    cfg = configured(f"recipe={recipe}", *TINY)
    model = classifier_of(cfg, 16)
    images, labels = batch()
    shown = model.adversary(images, labels)
    assert shown.shape == images.shape and shown.min() >= 0 and shown.max() <= 1
    assert torch.equal(shown, images) == (cfg.adversary.kind == "none")
    assert model.training and not shown.requires_grad


COSTS = [
    (Adversary(), 1.0),
    (Adversary(kind="moire", share=0.5), 1.0),
    (Adversary(kind="moire_attack", share=0.5, eps=0.02, steps=3), 2.5),
    (Adversary(kind="pgd", share=1.0, eps=0.02, steps=2), 3.0),
    (
        Adversary(kind="moire_attack", share=1.0, eps=0.02, steps=2, worst_of=3, turn=True),
        1 + 1 + 5 / 3 + 2,
    ),
    (Adversary(kind="moire", share=0.5, worst_of=3), 1.5),
]


@pytest.mark.parametrize(
    ("cfg", "cost"), COSTS, ids=[f"{c.kind}-{k}" for k, (c, _) in enumerate(COSTS)]
)
def test_passes_are_what_the_network_is_asked_for(cfg, cost):
    assert passes(cfg) == pytest.approx(cost)
    model = Counting()
    images, labels = batch(8)
    n = round(cfg.share * 8)
    Adversaries(model, SCENE, cfg)(images[:n], labels[:n])
    counted = (model.forwards / 3 + model.backwards * 2 / 3) / 8
    assert 1 + counted == pytest.approx(cost)


def test_passes_of_replayed_and_consistent_training():
    free = Adversary(kind="moire_attack", share=0.5, steps=1, replays=3)
    assert passes(free) == pytest.approx(1 + 0.5 / 3)
    assert passes(dataclasses.replace(free, replays=1, consistency=2.0)) == pytest.approx(
        1 + 0.5 * 2
    )


def test_replayed_noise_follows_the_training_steps_gradient():
    model = Counting()
    images, labels = batch()
    adversary = Adversaries(
        model, SCENE, Adversary(kind="moire_attack", eps=0.03, steps=1, replays=3)
    )
    torch.manual_seed(0)
    shown = adversary.show(images, labels, Moment())
    before = F.cross_entropy(model(shown.images()), labels)
    before.backward()
    after = shown.stepped(0.2, 0.03)
    assert after.noise.abs().max() <= 0.03
    assert F.cross_entropy(model(after.images()), labels) > before
    moved = (after.noise - shown.noise).abs()
    assert torch.allclose(moved[moved > 0].max(), torch.tensor(0.006), atol=1e-7)
    # the reading is the same: without noise, both are the same photo
    assert torch.equal(
        after.render(torch.zeros_like(after.noise)), shown.render(torch.zeros_like(shown.noise))
    )


def test_the_worst_shot_is_the_worst():
    model = Counting()
    images, labels = batch(8)

    def loss(shot):
        with torch.no_grad():
            return F.cross_entropy(model(capture(images, shot)), labels, reduction="none")

    def shot_of(**settings):
        torch.manual_seed(3)
        return Adversaries(model, SCENE, Adversary(kind="moire", **settings)).shot(
            images, labels, Moment()
        )

    several = SCENE.sample(40, (24, 24), torch.Generator().manual_seed(7))
    worst = Adversaries(model, SCENE, Adversary(kind="moire", worst_of=5))._worst(
        images, labels, several
    )
    every = torch.stack([loss(several[k * 8 : (k + 1) * 8]) for k in range(5)])
    assert torch.allclose(loss(worst), every.amax(0), atol=1e-5)
    # turned for the worse: of the same draw, no image's margin is better
    plain, turned = shot_of(), shot_of(turn=True)
    assert not torch.equal(plain.view.yaw, turned.view.yaw)

    def margin(shot):
        with torch.no_grad():
            logits = model(capture(images, shot))
        return (
            logits.scatter(1, labels[:, None], -1e9).amax(1)
            - logits.gather(1, labels[:, None])[:, 0]
        )

    assert (margin(turned) >= margin(plain) - 1e-5).all() and (margin(turned) > margin(plain)).any()
    ends = SCENE.view.yaw
    assert ends[0] <= turned.view.yaw.min() and turned.view.yaw.max() <= ends[1]


@pytest.mark.parametrize("width", [0.0, 0.25, 1.0])
def test_a_curriculum_draws_ranges_in_to_their_middles(width):
    shot = SCENE.sample(200, (24, 24), torch.Generator().manual_seed(0))
    near = narrowed(shot, width)
    low, high = SCENE.view.yaw
    middle, half = (low + high) / 2, (high - low) / 2
    assert near.view.yaw.sub(middle).abs().max() <= width * half + 1e-9
    assert torch.allclose(near.view.yaw - middle, width * (shot.view.yaw - middle))
    capture(torch.rand(200, 3, 24, 24), near)
    if width == 1:
        assert near is shot


def test_eps_and_ranges_rise_linearly(monkeypatch):
    model = classifier_of(
        configured("recipe=moire_at", *TINY, "adversary.warmup=0.5", "adversary.curriculum=0.25"),
        16,
    )
    model._trainer = type("Trainer", (), {"estimated_stepping_batches": 40})
    moments = []
    for step in (0, 4, 9, 19, 30):
        monkeypatch.setattr(Classifier, "global_step", step)
        moments.append(model._moment())
    assert [m.strength for m in moments] == pytest.approx([0.05, 0.25, 0.5, 1, 1])
    assert [m.width for m in moments] == pytest.approx([0.1, 0.5, 1, 1, 1])


def stepped(model, *args, **kwargs):
    """One training step away from a trainer."""
    model._moment = Moment
    model.log = lambda *a, **k: None
    return model.training_step(Batch(*args, **kwargs), 0)


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_consistency_is_the_loss_of_the_paper(share, monkeypatch):
    cfg = configured(
        "recipe=moire_trades", *TINY, f"adversary.share={share}", "adversary.consistency=2.5"
    )
    monkeypatch.setattr(Classifier, "current_epoch", property(lambda self: 0))
    model = classifier_of(cfg, 16).double()
    model.eval()  # so that both batches of images are normalised by the same statistics
    images, labels = torch.randint(0, 256, (6, 3, 24, 24), dtype=torch.uint8), torch.arange(6)
    n = round(share * 6)
    attacked = torch.rand(n, 3, 24, 24, dtype=torch.float64)
    model.adversary = lambda *args: attacked
    model._augmented = lambda batch: batch.images.double() / 255
    got = stepped(model, images, labels)
    clean = model(images.double() / 255)
    p, q = clean[:n].softmax(1), model(attacked).softmax(1)
    kl = (p * (p / q).log()).sum() / 6
    assert got.item() == pytest.approx((F.cross_entropy(clean, labels) + 2.5 * kl).item(), rel=1e-9)


def test_a_replayed_batch_is_photographed_once(monkeypatch):
    cfg = configured("recipe=moire_free", *TINY)
    monkeypatch.setattr(Classifier, "current_epoch", property(lambda self: 0))
    model = classifier_of(cfg, 16)
    taken = []
    problem = MoireAttack.problem
    monkeypatch.setattr(MoireAttack, "problem", lambda *a: taken.append(1) or problem(*a))
    images, labels = torch.randint(0, 256, (8, 3, 24, 24), dtype=torch.uint8), torch.arange(8)
    noises = []
    for visit in range(3):
        stepped(model, images, labels, slot=2, visit=visit).backward()
        noises.append(model._kept[2][0].noise.detach().clone())
    assert len(taken) == 1 and list(model._kept) == [2]
    assert not torch.equal(noises[0], noises[1]) and not torch.equal(noises[1], noises[2])
    assert max(x.abs().max() for x in noises) <= 8.01 / 255
    model.on_train_epoch_end()
    assert not model._kept


REFUSED = [
    ({"kind": "pdg"}, "Did you mean 'pgd'?"),
    ({"share": 1.5}, "adversary.share must lie in"),
    ({"curriculum": -1.0}, "adversary.curriculum must lie in"),
    ({"replays": 0}, "adversary.replays must be at least 1"),
    ({"kind": "moire", "replays": 2}, "Use moire_attack or pgd"),
    ({"kind": "pgd", "worst_of": 2}, "Use moire or moire_attack"),
    ({"kind": "none", "turn": True}, "Use moire or moire_attack"),
    ({"consistency": float("nan")}, "must be a weight >= 0"),
]


@pytest.mark.parametrize(("settings", "sentence"), REFUSED, ids=[next(iter(s)) for s, _ in REFUSED])
def test_adversaries_that_cannot_be_get_a_sentence(settings, sentence):
    with pytest.raises(ValueError, match=sentence.replace("?", r"\?")):
        check(Adversary(**settings))


@pytest.mark.parametrize(
    ("scene", "sentence"),
    [
        (
            dataclasses.replace(SCENE, sensor=dataclasses.replace(SCENE.sensor, exposure="point")),
            "differentiable in",
        ),
        (
            Scene(panel=Panel(phase=0.0)),
            "searches the ranges of panel and view, and the scene has none",
        ),
    ],
)
def test_a_scene_that_nothing_can_be_turned_in_gets_a_sentence(scene, sentence):
    with pytest.raises(ValueError, match=sentence):
        Adversaries(nn.Identity(), scene, Adversary(kind="moire", turn=True))


def test_shown_moves_within_its_ball():
    shown = Shown(lambda noise: noise.clamp(0, 1), torch.full((2, 3), 0.019))
    shown.images().sum().backward()
    assert torch.equal(shown.stepped(1.0, 0.02).noise, torch.full((2, 3), 0.02))
    with pytest.raises(RuntimeError, match="call backward"):
        Shown(lambda noise: noise, torch.zeros(2, 3)).stepped(1.0, 0.02)
