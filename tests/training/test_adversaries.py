"""What recipes train on: each one's batch, step and cost."""

import pytest
import torch
from torch import nn

from moireaug.scenes import Scene
from tests.training.small import TINY, configured
from training.classifier.adversaries import ATTACK_OF_KIND, TrainingAdversary, passes
from training.classifier.module import Classifier
from training.classifier.train import classifier_of, try_out
from training.config.checks import check_adversary
from training.config.schema import ATTACKS, RECIPES, Adversary
from training.data.load import load
from training.recipe.phases import ClassificationTask
from training.runs.run import Run

pytestmark = pytest.mark.usefixtures("as_the_command_is")

SCENE = Scene.preset("screen_photo")


def test_every_kind_of_attack_has_one_and_an_unknown_kind_is_not_left_unattacked():
    assert set(ATTACK_OF_KIND) == set(ATTACKS)
    with pytest.raises(KeyError, match="mifgsm"):
        TrainingAdversary(nn.Identity(), SCENE, Adversary(kind="mifgsm", share=0.5))


class Counting(nn.Module):
    """A linear classifier that counts the images it sees, with and without gradient, and keeps the
    last."""

    def __init__(self):
        super().__init__()
        torch.manual_seed(0)
        self.head = nn.Linear(3 * 24 * 24, 8)
        self.forwards, self.backwards = 0, 0

    def forward(self, x):
        self.seen = x.detach()
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
    assert not torch.equal(shown, images)
    assert model.training and not shown.requires_grad


COSTS = [
    (Adversary(), 1.0),
    (Adversary(natural=0.5), 1.0),
    (Adversary(kind="moire_attack", share=0.5, eps=0.02, steps=3), 2.5),
    (Adversary(kind="pgd", share=1.0, eps=0.02, steps=2), 3.0),
    (Adversary(kind="photographed_pgd", share=1.0, eps=0.02, steps=2), 3.0),
    (Adversary(kind="pgd_on_photo", share=1.0, eps=0.02, steps=2), 3.0),
    (Adversary(kind="moire_attack", share=0.5, natural=0.25, eps=0.02, steps=2), 2.0),
    (Adversary(kind="moire_attack", share=0.5, eps=0.02, steps=2, optimise=["view"], draws=3), 2.5),
]


@pytest.mark.parametrize(("cfg", "cost"), COSTS)
def test_passes_are_what_the_network_is_asked_for(cfg, cost):
    assert passes(cfg, "labels") == pytest.approx(cost)
    model = Counting()
    images, labels = batch(8)
    n = round(cfg.share * 8)
    TrainingAdversary(model, SCENE, cfg)(images[:n], labels[:n])
    counted = (model.forwards / 3 + model.backwards * 2 / 3) / 8
    assert 1 + counted == pytest.approx(cost)


def test_photographed_pgd_photographs_what_pgd_attacked():
    model = Counting()
    images, labels = batch()
    cfg = Adversary(kind="photographed_pgd", share=1.0, eps=0.02, steps=2)
    adversary = TrainingAdversary(model, SCENE, cfg)
    torch.manual_seed(0)
    shown = adversary(images, labels)
    torch.manual_seed(0)
    attacked = ATTACK_OF_KIND["pgd"](model, SCENE, cfg).last(images, labels)
    assert (attacked - images).abs().max() == pytest.approx(0.02)
    assert torch.equal(shown, adversary.photograph(attacked))


def test_pgd_on_photo_attacks_the_photo_itself():
    model = Counting()
    images, labels = batch()
    cfg = Adversary(kind="pgd_on_photo", share=1.0, eps=0.02, steps=2)
    adversary = TrainingAdversary(model, SCENE, cfg)
    torch.manual_seed(0)
    attacked = adversary(images, labels)
    torch.manual_seed(0)
    photos = adversary.photograph(images)
    assert (attacked - photos).abs().max() == pytest.approx(0.02)
    assert (attacked - images).abs().max() > 0.05


def test_eps_rises_linearly(monkeypatch):
    model = classifier_of(configured("recipe=moire_at", *TINY, "adversary.warmup=0.5"), 16)
    model._trainer = type("Trainer", (), {"estimated_stepping_batches": 40})
    strengths = []
    for step in (0, 4, 9, 19, 30):
        monkeypatch.setattr(Classifier, "global_step", step)
        strengths.append(model._strength())
    assert strengths == pytest.approx([0.05, 0.25, 0.5, 1, 1])


PARTS = [  # recipe, share, natural
    ("moire_at", 0.5, 0.25),  # attacked, photographed, clean
    ("moire_at", 0.5, 0.0),  # attacked and clean
    ("moire_at", 0.75, 0.25),  # no clean one
    ("pgd_at", 0.25, 0.5),  # pixels beside photos
    ("moire_aug", 0.0, 0.5),  # photos and clean
]


@pytest.mark.parametrize(("recipe", "share", "natural"), PARTS)
def test_a_batch_has_its_parts(recipe, share, natural):
    parts = [f"adversary.share={share}", f"adversary.natural={natural}"]
    cfg = configured(f"recipe={recipe}", *TINY, *parts)
    model = classifier_of(cfg, 16)
    model.model = Counting()
    model.adversary = TrainingAdversary(model.model, model.scene, cfg.adversary)
    photographed = []
    take = model.adversary.photograph
    model.adversary.photograph = lambda x: photographed.append(x) or take(x)
    images = torch.randint(0, 256, (8, 3, 24, 24), dtype=torch.uint8)
    model._strength, model.log = lambda: 1.0, lambda *given, **settings: None
    model.training_step((images, torch.arange(8)), 0)
    n, end = round(share * 8), round((share + natural) * 8)
    same = (model.model.seen == images / 255).flatten(1).all(1)
    assert same.tolist() == [False] * end + [True] * (8 - end)
    assert sum(map(len, photographed)) == end - n
    for photo in photographed:
        assert torch.equal(photo, images[n:end] / 255)


def test_a_batch_too_small_for_its_parts_is_not_left_unattacked(tmp_path):
    """Half of a single image is none."""
    for recipe, settings, sentence in (
        ("moire_fast", ["train.batch_size=1"], "share=0.5 of the 1 image .* larger train.batch_si"),
        ("moire_aug", ["adversary.natural=0.02"], "adversary.natural=0.02 of the 16 images"),
        ("moire_aug", ["adversary.natural=0.1", "data.train=4"], "natural=0.1 of the 4 images"),
    ):
        cfg = configured(f"recipe={recipe}", *TINY, f"runs={tmp_path}", *settings)
        with pytest.raises(ValueError, match=sentence):
            try_out(Run(cfg), load(cfg.data))
    for recipe in ("moire_at", "moire_fast", "pgd_at", "moire_aug", "clean"):
        cfg = configured(f"recipe={recipe}", *TINY, "train.batch_size=2", f"runs={tmp_path}")
        try_out(Run(cfg), load(cfg.data))


def test_adversaries_that_cannot_be_get_a_sentence():
    pgd = {"kind": "pgd", "steps": 2, "eps": 0.02}
    for settings, sentence in (
        ({"share": 0.5}, "the kind none attacks none: use moire_attack, pgd, photo"),
        (pgd | {"share": 0.75, "natural": 0.5}, "must not add up to"),
        (pgd, "needs a share, steps and eps above 0; got 0.0, 2"),
    ):
        with pytest.raises(ValueError, match=sentence):
            check_adversary(Adversary(**settings))


NO_EFFECT = {
    "recipe=pgd_at adversary.bound=light": "on adversary.kind=pgd: leave it out; it is for moire_",
    "recipe=pgd_at adversary.draws=3": "on adversary.kind=pgd",
    "recipe=pgd_at adversary.optimise=[view]": "on adversary.kind=pgd",
    "recipe=pgd_at adversary.natural=0 adversary.moire=false": "on adversary.kind=pgd",
    "recipe=pgd_at adversary.kind=photographed_pgd adversary.draws=3": "kind=photographed_pgd",
    "recipe=pgd_at adversary.kind=pgd_on_photo adversary.bound=light": "kind=pgd_on_photo",
    "recipe=moire_aug adversary.eps=0.1": "on adversary.kind=none",
    "recipe=moire_aug adversary.steps=2": "on adversary.kind=none",
    "recipe=moire_aug adversary.warmup=0.5": "on adversary.kind=none",
    "recipe=moire_at train.kept=0.5": "on train.target=labels",
}
AN_EFFECT = (
    "recipe=pgd_at adversary.kind=photographed_pgd adversary.natural=0 adversary.moire=false",
    "recipe=pgd_at adversary.kind=pgd_on_photo adversary.natural=0 adversary.moire=false",
    "recipe=pgd_at adversary.moire=false",
    "recipe=moire_aug adversary.moire=false",
    "recipe=moire_at adversary.natural=0 adversary.moire=false adversary.bound=light",
)


def test_settings_that_a_training_would_not_use_are_refused():
    for given, sentence in NO_EFFECT.items():
        with pytest.raises(ValueError, match=f"{given.split()[-1].partition('=')[0]}=.*{sentence}"):
            ClassificationTask().check(configured(*given.split()))
    for given in AN_EFFECT:
        ClassificationTask().check(configured(*given.split()))


def test_the_page_of_recipes_has_their_bounds():
    rows = (RECIPES.parent / "docs/training.md").read_text("utf-8").splitlines()
    for path in RECIPES.glob("*.yaml"):
        cfg = configured(f"recipe={path.stem}")
        adversary = cfg.adversary
        (row,) = [row for row in rows if row.startswith(f"| `{path.stem}` |")]
        assert row.split("|")[-2].strip() == f"{passes(adversary, cfg.train.target):.2g}"
        if adversary.kind == "none":
            continue
        assert f"in {adversary.steps} steps at {255 * adversary.eps:.0f}/255" in row
        assert f"{100 * adversary.share:g} % attacked" in row
