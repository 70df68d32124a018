"""A device's memory changes no figure: where a batch does not fit, the model takes it in parts."""

import copy
import dataclasses
import functools
from contextlib import nullcontext

import pytest
import torch

from moireaug.defenses import PixelDeflection
from moireaug.evaluation.attackers import MoireAttacker, PhotoUnknownAttacker, PixelAttacker
from moireaug.evaluation.autoattack import SquareAttacker
from moireaug.evaluation.batches import restored_generators
from moireaug.evaluation.classifiers import UNDEFENDED, Classifier, within_memory
from moireaug.evaluation.conditions import EvalBatch, RandomNoise
from tests.evaluation.haze import EPS, SCENE

CONDITIONS = {
    "noise": RandomNoise(eps=EPS),
    "restarts": MoireAttacker(eps=EPS, steps=2, restarts=2),
    "unknown photo": PhotoUnknownAttacker(eps=EPS, steps=2, shots=2),
    "search": SquareAttacker(eps=EPS, steps=8),
    "pixels": PixelAttacker(attack="pgd", eps=EPS, steps=2),
    "defence": MoireAttacker(
        eps=EPS, steps=2, known_classifier=Classifier("dark", defence=lambda x: 0.5 * x)
    ),
    "deflection": MoireAttacker(
        eps=EPS, steps=2, known_classifier=Classifier("d", PixelDeflection(20))
    ),
}
MAX_IMAGES = 2  # of 6 that fit


@pytest.fixture(scope="module")
def batch(known):
    """In float64, where no gradient's sign hangs on the size of a part."""
    model, ((images, labels), _) = known
    shot = SCENE.sample(6, (8, 8), torch.Generator().manual_seed(1))
    model, images = copy.deepcopy(model).double(), images[:6, :, :8, :8].double()
    return EvalBatch(model, images, labels[:6], labels[:6], shot, torch.Generator())


def limited(model):
    """The model on a device that holds few images."""

    def small(images):
        if len(images) > MAX_IMAGES:
            raise torch.OutOfMemoryError("too much")
        return model(images)

    return small


def confined(condition):
    """The same condition, whose defence is on a device that holds few images."""
    classifier = getattr(condition, "known_classifier", UNDEFENDED)
    if classifier is UNDEFENDED:
        return condition
    classifier = dataclasses.replace(classifier, defence=limited(classifier.defence))
    return dataclasses.replace(condition, known_classifier=classifier)


def noisy(limit):
    """A randomised defence whose draws decide answers, on a device of that limit."""
    defence = limit(lambda images: images * torch.rand(len(images), 3, 1, 1, dtype=torch.float64))
    defence.randomised = True
    return defence


@pytest.mark.parametrize("condition", CONDITIONS.values(), ids=CONDITIONS)
def test_the_images_do_not_depend_on_the_memory(condition, batch):
    shown = []
    for model, one in ((batch.model, condition), (limited(batch.model), confined(condition))):
        batch.generator.manual_seed(2)
        torch.manual_seed(2)
        shown.append(within_memory(one.show, dataclasses.replace(batch, model=model)))
    # but where gradients of several views cancel, and a rounding decides their sign
    differing = (shown[0] - shown[1]).abs() > 1e-6
    assert differing.double().mean() < 0.02


@pytest.mark.parametrize("part", ["model", "target", "defence"])
def test_nor_do_the_answers(part, batch):
    answers = []
    for limit in (lambda model: model, limited):
        classifier, model = UNDEFENDED, batch.model
        if part == "model":
            model = limit(model)
        elif part == "target":
            classifier = Classifier("target", model=limit(model))
        else:
            classifier = Classifier("noisy", noisy(limit), draws=2)
        predict = functools.partial(classifier.predictions, images=batch.images)
        torch.manual_seed(0)
        answers.append(within_memory(predict, dataclasses.replace(batch, model=model)))
    assert torch.equal(*answers)


def test_a_failed_attempt_draws_nothing(batch):
    drawn = []

    def model(images):
        noise = torch.rand(len(images))
        if len(images) > MAX_IMAGES:
            raise torch.OutOfMemoryError("too much")
        drawn.append(noise)
        return batch.model(images)

    torch.manual_seed(0)

    def answers(own):
        return UNDEFENDED.defended(own.model, own.max_images)(own.images)

    within_memory(answers, dataclasses.replace(batch, model=model))
    torch.manual_seed(0)
    assert torch.equal(torch.cat(drawn), torch.rand(6))


def test_what_does_not_fit_at_all_is_refused_with_advice(batch):
    def none(images):
        raise torch.OutOfMemoryError("not even one")

    with pytest.raises(torch.OutOfMemoryError, match="not even one") as error:
        within_memory(CONDITIONS["pixels"].show, dataclasses.replace(batch, model=none))
    assert error.value.__notes__ == ["The batch has 6 images: pass smaller batches."]


def test_every_generator_is_restored(monkeypatch):
    """Seeding torch seeds each GPU, also one that computes nothing here."""
    restored = []
    monkeypatch.setattr(torch.cuda, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.random, "fork_rng", lambda d: restored.extend(d) or nullcontext())
    with restored_generators():
        assert restored == [0, 1]
