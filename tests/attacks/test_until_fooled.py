"""Fooled images take no further step: as many are fooled with fewer queries, and a model that
answers at random is attacked in every step."""

import copy

import pytest
import torch
from torch import nn

from moireaug import capture
from moireaug.attacks import PGD, MoireAttack, MultiTargeted, Patch, SquareMoire
from tests.attacks.common import SCENE, predicted, striped

EPS = 6 / 255  # fools some early, whatever the last digits of the training are
STEPS = 6


class Counted(nn.Module):
    """Counts the images that a model is asked about."""

    def __init__(self, model):
        super().__init__()
        self.model = model
        self.asked = 0

    def forward(self, images):
        self.asked += len(images)
        return self.model(images)


@pytest.fixture(scope="module")
def problem(trained):
    """A model, images of which noise fools some, and their shot; in float64, where no gradient's
    sign hangs on the size of the batch."""
    g = torch.Generator().manual_seed(0)
    images, labels = striped(32, g)
    shot = SCENE.sample(len(images), (16, 16), g)
    model = copy.deepcopy(trained(capture(images, shot), labels)).double()
    return model, images.double(), labels, shot


ATTACKS = {
    "sign": (MoireAttack, {}),
    "momentum": (MoireAttack, {"rule": "momentum"}),
    "apgd": (MoireAttack, {"rule": "apgd"}),
    "margin": (MoireAttack, {"loss": "margin"}),
    "restarts": (MoireAttack, {"restarts": 2}),
    "photo": (MoireAttack, {"noise_at": "photo"}),
    "turning": (MoireAttack, {"optimise": ("noise", "view")}),
    "pgd": (PGD, {}),
    "patch": (Patch, {"area": 0.3}),
    "square": (SquareMoire, {"eps": 48 / 255}),
}


@pytest.mark.parametrize(
    ("name", "targeted"),
    [*((name, False) for name in ATTACKS), *((name, True) for name in ("sign", "pgd", "square"))],
)
def test_as_many_are_fooled_for_less(problem, name, targeted):
    model, images, labels, shot = problem
    kind, settings = ATTACKS[name]
    settings = {"eps": EPS * (4 if targeted else 1), "steps": STEPS} | settings
    if issubclass(kind, MoireAttack):
        settings["scene"] = SCENE
    pose = shot if issubclass(kind, MoireAttack) else None
    targets = (labels + 1) % 5 if targeted else None
    found, asked = [], []
    for until_fooled in (False, True):
        counted = Counted(model)
        attack = kind(counted, until_fooled=until_fooled, **settings)
        g = torch.Generator().manual_seed(1)
        found.append(attack(images, labels, targets, shot=pose, generator=g))
        asked.append(counted.asked)
    whole, short = found
    assert whole.success.equal(short.success)
    assert whole.success.any(), "or the test says nothing"
    assert asked[1] < asked[0]
    # what is never fooled is searched as before; a restart of others draws the same noise
    left = ~whole.success
    torch.testing.assert_close(short.images[left], whole.images[left], atol=1e-6, rtol=0)


def test_noise_that_fools_early_is_smaller(problem):
    model, images, labels, shot = problem
    means = []
    for until_fooled in (False, True):
        settings = {"scene": SCENE, "steps": STEPS, "until_fooled": until_fooled}
        result = MoireAttack(model, eps=16 / 255, **settings)(images, labels, shot=shot)
        assert result.success.all()
        means.append(result.noise.abs().mean())
    assert means[1] < 0.8 * means[0]


def test_a_fooled_batch_is_asked_no_more(problem):
    """Twice at first, to see that the model answers the same, and for the photo that is kept."""
    model, images, labels, shot = problem
    counted = Counted(model)
    attack = MoireAttack(counted, scene=SCENE, eps=EPS, steps=STEPS, restarts=3, until_fooled=True)
    result = attack(images, (labels + 1) % 5, shot=shot)
    assert result.success.all() and counted.asked == 3 * len(images)
    assert not result.noise.any() and len(result.loss) == 1


def test_training_asks_once_in_every_step(problem):
    """Whatever is fooled: the last images are those after all steps."""
    model, images, labels, shot = problem
    photos = []
    for until_fooled in (False, True):
        counted = Counted(model)
        settings = {"restarts": 2, "until_fooled": until_fooled}
        attack = MoireAttack(counted, scene=SCENE, eps=EPS, steps=STEPS, **settings)
        photos.append(attack.last(images, labels, shot=shot))
        assert counted.asked == STEPS * len(images)
    assert photos[0].equal(photos[1])


def test_the_unit_of_the_logits_does_not_matter(problem):
    model, images, labels, shot = problem
    found, asked = [], []
    for scale in (1.0, 1e4, 1e-4):
        counted = Counted(lambda x, scale=scale: scale * model(x))
        settings = {"loss": "margin", "until_fooled": True}
        attack = MoireAttack(counted, scene=SCENE, eps=EPS, steps=STEPS, **settings)
        found.append(attack(images, labels, shot=shot))
        asked.append(counted.asked)
    assert all(found[0].images.equal(other.images) for other in found)
    assert asked[0] == asked[1] == asked[2] < STEPS * len(images)


def random_logits(model, asked, factor=1.0):
    """A model that answers at random, and notes how many images it is asked about."""

    def answer(images):
        asked.append(len(images))
        return factor * (model(images) + torch.randn(len(images), 5).to(images))

    return answer


def test_a_model_that_answers_at_random_is_attacked_in_every_step(problem):
    """To be fooled by luck is not to be fooled: stopping there would flatter the model."""
    model, images, labels, shot = problem
    for factor in (1e4, 1.0, 1e-4):
        asked = []
        random = random_logits(model, asked, factor)
        settings = {"scene": SCENE, "eps": EPS, "steps": STEPS, "until_fooled": True}
        MoireAttack(random, **settings)(images, labels, shot=shot)
        # each step, whether it answers the same, the last point, the photo that is kept
        assert sum(asked) == (STEPS + 1 + 1 + 1) * len(images), factor


def test_no_image_is_done_by_one_lucky_draw(problem):
    """Where answers do not repeat, every image is attacked toward every class."""
    model, images, labels, shot = problem
    asked = []
    attack = MoireAttack(random_logits(model, asked), scene=SCENE, eps=EPS, steps=1)
    MultiTargeted(attack, targets=2)(images, labels, shot=shot)
    assert set(asked) == {len(images)}


def test_a_search_toward_several_classes_says_what_is_fooled(problem):
    model, images, labels, shot = problem
    attack = MoireAttack(model, scene=SCENE, eps=4 / 255, steps=STEPS, until_fooled=True)
    result = MultiTargeted(attack, targets=2)(images, labels, shot=shot)
    assert predicted(model, result.images).ne(labels).equal(result.success)


def test_an_expectation_over_shots_is_refused(problem):
    with pytest.raises(ValueError, match="it needs eot = 1; got 4"):
        MoireAttack(problem[0], scene=SCENE, eot=4, until_fooled=True)
