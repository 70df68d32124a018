"""Fooled images take no further step, unless the model answers at random."""

import pytest
import torch

from moireaug.attacks import PGD, MoireAttack, MultiTargeted, Patch, SquareMoire
from tests.attacks.common import SCENE, counting, predicted

EPS = 6 / 255  # fools some early, whatever the last digits of the training are
STEPS = 6


@pytest.fixture(scope="module")
def problem(learnt_photos):
    """In float64, where no gradient's sign hangs on the size of the batch."""
    model, images, labels, shot = learnt_photos(32)
    return model.double(), images.double(), labels, shot


ATTACKS = {
    "sign": (MoireAttack, {}),
    "momentum": (MoireAttack, {"rule": "momentum"}),
    "apgd": (MoireAttack, {"rule": "apgd"}),
    "margin": (MoireAttack, {"loss": "margin"}),
    "restarts": (MoireAttack, {"restarts": 2}),
    "photo": (MoireAttack, {"noise_at": "photo"}),
    "turning": (MoireAttack, {"optimise": ("noise", "view")}),
    "pgd": (PGD, {}),
    "patch": (Patch, {"area": 0.3, "eps": 24 / 255}),
    "square": (SquareMoire, {"eps": 48 / 255}),
}


@pytest.mark.parametrize(
    ("name", "targeted"),
    [*((name, False) for name in ATTACKS), *((name, True) for name in ("sign", "pgd", "square"))],
)
def test_as_many_are_fooled_for_less(problem, name, targeted):
    model, images, labels, shot = problem
    if name == "turning":  # the search of a pose takes longest
        images, labels, shot = images[:12], labels[:12], shot[:12]
    kind, settings = ATTACKS[name]
    settings = {"eps": EPS * (4 if targeted else 1), "steps": STEPS} | settings
    if issubclass(kind, MoireAttack):
        settings["scene"] = SCENE
    pose = shot if issubclass(kind, MoireAttack) else None
    targets = (labels + 1) % 5 if targeted else None
    found, totals = [], []
    for until_fooled in (False, True):
        counted, asked = counting(model)
        attack = kind(counted, until_fooled=until_fooled, **settings)
        g = torch.Generator().manual_seed(1)
        found.append(attack(images, labels, targets, shot=pose, generator=g))
        totals.append(sum(asked))
    whole, short = found
    assert whole.success.equal(short.success)
    assert whole.success.any(), "or the test says nothing"
    assert totals[1] < totals[0]
    # what is never fooled is searched as before; a restart of others draws the same noise
    left = ~whole.success
    torch.testing.assert_close(short.images[left], whole.images[left], atol=1e-6, rtol=0)


def until_fooled(model, **settings):
    return MoireAttack(
        model, **{"scene": SCENE, "eps": EPS, "steps": STEPS, "until_fooled": True} | settings
    )


def test_a_fooled_batch_is_asked_no_more(problem):
    """Twice at first, to see that the model answers the same, and for the photo that is kept."""
    model, images, labels, shot = problem
    counted, asked = counting(model)
    result = until_fooled(counted, restarts=3)(images, (labels + 1) % 5, shot=shot)
    assert result.success.all() and asked == [len(images)] * 3
    assert not result.noise.any() and len(result.loss) == 1


def test_a_model_that_repeats_its_answers_is_asked_so_once(problem):
    """Not in every restart, and not toward every class, which MultiTargeted has asked before."""
    model, images, labels, shot = problem
    calls = {}
    for stops in (False, True):
        for restarts in (1, 3):
            counted, asked = counting(model)
            attack = until_fooled(counted, eps=0.0, restarts=restarts, until_fooled=stops)
            attack(images, labels, shot=shot)
            calls[stops, restarts] = len(asked)
        counted, asked = counting(model)
        attack = until_fooled(counted, eps=0.0, until_fooled=stops)
        MultiTargeted(attack, targets=2)(images, labels, shot=shot)
        calls[stops, "classes"] = len(asked)
    assert calls[True, 1] == calls[False, 1] + 1 and calls[True, 3] == calls[False, 3] + 1
    assert calls[True, "classes"] == calls[False, "classes"]


def test_training_asks_once_in_every_step(problem):
    """Whatever is fooled: the last images are those after all steps."""
    model, images, labels, shot = problem
    photos = []
    for stops in (False, True):
        counted, asked = counting(model)
        attack = until_fooled(counted, restarts=2, until_fooled=stops)
        photos.append(attack.last(images, labels, shot=shot))
        assert asked == [len(images)] * STEPS
    assert photos[0].equal(photos[1])


def test_the_unit_of_the_logits_does_not_matter(problem):
    model, images, labels, shot = problem
    found = []
    for scale in (1.0, 1e4, 1e-4):
        counted, asked = counting(lambda x, scale=scale: scale * model(x))
        result = until_fooled(counted, loss="margin")(images, labels, shot=shot)
        found.append((sum(asked), result.images))
    for total, photos in found:
        assert total == found[0][0] < STEPS * len(images) and photos.equal(found[0][1])


def at_random(model, factor=1.0):
    return counting(lambda x: factor * (model(x) + torch.randn(len(x), 5).to(x)))


def test_answers_at_random_are_attacked_in_every_step(problem):
    """To be fooled by luck is not to be fooled: stopping there would flatter the model."""
    model, images, labels, shot = problem
    for factor in (1e4, 1.0, 1e-4):
        random, asked = at_random(model, factor)
        until_fooled(random)(images, labels, shot=shot)
        # each step, whether it answers the same, the last point, the photo that is kept
        assert asked == [len(images)] * (STEPS + 1 + 1 + 1), factor


def test_no_image_is_done_by_one_lucky_draw(problem):
    """Where answers do not repeat, every image is attacked toward every class."""
    model, images, labels, shot = problem
    random, asked = at_random(model)
    attack = MoireAttack(random, scene=SCENE, eps=EPS, steps=1)
    MultiTargeted(attack, targets=2)(images, labels, shot=shot)
    assert set(asked) == {len(images)}


def test_a_search_toward_several_classes_says_what_is_fooled(problem):
    model, images, labels, shot = problem
    result = MultiTargeted(until_fooled(model), targets=2)(images, labels, shot=shot)
    assert predicted(model, result.images).ne(labels).equal(result.success)


def test_an_expectation_over_shots_is_refused(problem):
    with pytest.raises(ValueError, match="it needs eot = 1; got 4"):
        until_fooled(problem[0], eot=4)
