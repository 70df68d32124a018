"""What recipes train on: each one's batch, step and cost, and replayed noise."""

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from moireaug.attacks import MoireAttack
from moireaug.scene.scene import Scene
from tests.training.small import TINY, configured
from training.adversaries import Adversaries, Shown, check, passes
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
    (Adversary(kind="moire_attack", share=0.5, natural=0.25, eps=0.02, steps=2), 2.0),
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


def test_passes_of_replayed_training():
    free = Adversary(kind="moire_attack", share=0.5, steps=1, replays=3)
    assert passes(free) == pytest.approx(1 + 0.5 / 3)


def test_replayed_noise_follows_the_training_steps_gradient():
    model = Counting()
    images, labels = batch()
    adversary = Adversaries(
        model, SCENE, Adversary(kind="moire_attack", eps=0.03, steps=1, replays=3)
    )
    torch.manual_seed(0)
    shown = adversary.show(images, labels)
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


def test_eps_rises_linearly(monkeypatch):
    model = classifier_of(configured("recipe=moire_at", *TINY, "adversary.warmup=0.5"), 16)
    model._trainer = type("Trainer", (), {"estimated_stepping_batches": 40})
    strengths = []
    for step in (0, 4, 9, 19, 30):
        monkeypatch.setattr(Classifier, "global_step", step)
        strengths.append(model._strength())
    assert strengths == pytest.approx([0.05, 0.25, 0.5, 1, 1])


def stepped(model, *args, **kwargs):
    """One training step away from a trainer."""
    model._strength = lambda: 1.0
    model.log = lambda *a, **k: None
    return model.training_step(Batch(*args, **kwargs), 0)


class Seeing(nn.Module):
    """Keeps the images of the last training step."""

    def __init__(self):
        super().__init__()
        torch.manual_seed(0)
        self.head = nn.Linear(3 * 24 * 24, 16)

    def forward(self, x):
        self.seen = x.detach()
        return self.head(x.flatten(1))


PARTS = {  # recipe, share, natural
    "attacked, photographed, clean": ("moire_at", 0.5, 0.25),
    "attacked and clean": ("moire_at", 0.5, 0.0),
    "no clean one": ("moire_at", 0.75, 0.25),
    "replayed": ("moire_free", 0.5, 0.25),
    "pixels beside photos": ("pgd_at", 0.25, 0.5),
    "photos alone": ("clean", 1.0, 0.5),  # a share of nothing
}


@pytest.mark.parametrize(("recipe", "share", "natural"), PARTS.values(), ids=PARTS)
def test_a_batch_has_its_parts(recipe, share, natural):
    cfg = configured(
        f"recipe={recipe}", *TINY, f"adversary.share={share}", f"adversary.natural={natural}"
    )
    model = classifier_of(cfg, 16)
    model.model = Seeing()
    model.adversary = Adversaries(model.model, model.scene, cfg.adversary)
    photographed = []
    take = model.adversary.photograph
    model.adversary.photograph = lambda x: photographed.append(x) or take(x)
    images = torch.randint(0, 256, (8, 3, 24, 24), dtype=torch.uint8)
    stepped(model, images, torch.arange(8))
    n = round(share * 8) if cfg.adversary.kind != "none" else 0
    end = n + round(natural * 8)
    same = (model.model.seen == images / 255).flatten(1).all(1)
    assert same.tolist() == [False] * end + [True] * (8 - end)
    assert sum(map(len, photographed)) == end - n
    for photo in photographed:
        assert torch.equal(photo, images[n:end] / 255)


def test_a_replayed_batch_is_photographed_once(monkeypatch):
    cfg = configured("recipe=moire_free", *TINY)
    model = classifier_of(cfg, 16)
    taken = []
    problem = MoireAttack.problem
    monkeypatch.setattr(MoireAttack, "problem", lambda *a: taken.append(1) or problem(*a))
    images, labels = torch.randint(0, 256, (8, 3, 24, 24), dtype=torch.uint8), torch.arange(8)
    noises = []
    for visit in range(3):
        stepped(model, images, labels, slot=2, visit=visit).backward()
        noises.append(model._kept[2][1].noise.detach().clone())
    assert len(taken) == 1 and list(model._kept) == [2]
    assert not torch.equal(noises[0], noises[1]) and not torch.equal(noises[1], noises[2])
    assert max(x.abs().max() for x in noises) <= 6.01 / 255
    model.on_train_epoch_end()
    assert not model._kept


def test_batches_too_small_for_the_share_are_replayed_without_an_attack():
    cfg = configured("recipe=moire_free", *TINY, "adversary.share=0.1", "adversary.natural=0.1")
    model = classifier_of(cfg, 16)
    model.model = Seeing()
    images, labels = torch.randint(0, 256, (4, 3, 24, 24), dtype=torch.uint8), torch.arange(4)
    for visit in range(2):
        stepped(model, images, labels, visit=visit)
        assert torch.equal(model.model.seen, images / 255)


REFUSED = [
    ({"kind": "pdg"}, "Did you mean 'pgd'?"),
    ({"share": 1.5}, "adversary.share must lie in"),
    ({"natural": -1.0}, "adversary.natural must lie in"),
    ({"kind": "pgd", "share": 0.75, "natural": 0.5}, "must not add up to more than 1"),
    ({"replays": 0}, "adversary.replays must be at least 1"),
    ({"kind": "moire", "replays": 2}, "Use moire_attack or pgd"),
]


@pytest.mark.parametrize(("settings", "sentence"), REFUSED, ids=[next(iter(s)) for s, _ in REFUSED])
def test_adversaries_that_cannot_be_get_a_sentence(settings, sentence):
    with pytest.raises(ValueError, match=sentence.replace("?", r"\?")):
        check(Adversary(**settings))


def test_shown_moves_within_its_ball():
    shown = Shown(lambda noise: noise.clamp(0, 1), torch.full((2, 3), 0.019))
    shown.images().sum().backward()
    assert torch.equal(shown.stepped(1.0, 0.02).noise, torch.full((2, 3), 0.02))
    with pytest.raises(RuntimeError, match="call backward"):
        Shown(lambda noise: noise, torch.zeros(2, 3)).stepped(1.0, 0.02)
