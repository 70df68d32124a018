"""Models without a gradient are refused by everything that needs one; a gradient of zeros is not.

An operator without a derivative, as those of dynamically quantised layers, gives None; what stands
before it, a camera or a defence, must not make zeros of that."""

import contextlib

import pytest
import torch
from torch import nn

from moireaug import capture, evaluation
from moireaug.attacks import CW, PGD, MoireAttack, MultiTargeted, Photographed, SquareMoire
from moireaug.defenses import JPEG, Compose, Defended, Median
from moireaug.engine import reference
from moireaug.transforms import AdversarialMoire
from tests.attacks.common import SCENE, refusal

SENTENCE = "logits have no gradient"


class NoDerivative(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x):
        return x.clone()

    @staticmethod
    def backward(ctx, gradient):
        return None


class Zeros(torch.autograd.Function):
    """Is given zeros where there is no gradient, as is torch's habit, and passes them on."""

    @staticmethod
    def forward(ctx, x):
        return x.clone()

    @staticmethod
    def backward(ctx, gradient):
        return gradient


def quantised(model):
    return lambda x: model(NoDerivative.apply(x))


def behind_a_function(model):
    return lambda x: model(NoDerivative.apply(Zeros.apply(x)))


def behind_defences(model):
    return Defended(quantised(model), Compose((Median(3), JPEG(70))))


CALLS = {
    "photo": lambda m, x, y: MoireAttack(m, scene=SCENE, steps=1)(x, y),
    "last": lambda m, x, y: MoireAttack(m, scene=SCENE, steps=1).last(x, y),
    "on the photo": lambda m, x, y: MoireAttack(m, scene=SCENE, steps=1, noise_at="photo")(x, y),
    "expectation": lambda m, x, y: MoireAttack(m, scene=SCENE, steps=1, eot=2)(x, y),
    "mixture": lambda m, x, y: MoireAttack(m, scene=[SCENE, "paper"], steps=1)(x, y),
    "pose": lambda m, x, y: MoireAttack(m, scene=SCENE, steps=1, optimise=("view",))(x, y),
    "toward": lambda m, x, y: MultiTargeted(MoireAttack(m, scene=SCENE, steps=1))(x, y),
    "pixels": lambda m, x, y: PGD(m, steps=1)(x, y),
    "cw": lambda m, x, y: CW(m, steps=1)(x, y),
    "transform": lambda m, x, y: AdversarialMoire(m, SCENE, steps=1)(x, y),
    "evaluate": lambda m, x, y: evaluation.evaluate(
        m, [(x, y)], "ladder", SCENE, steps=1, progress=False
    ),
}


@pytest.fixture
def linear(batch):
    """A linear model, and a batch that it gets right."""
    torch.manual_seed(0)
    model, images = nn.Sequential(nn.Flatten(), nn.Linear(768, 5)), batch[0][:3]
    return model, images, model(images).argmax(1)


@pytest.mark.parametrize("wrapped", [quantised, behind_a_function, behind_defences])
def test_no_gradient_is_refused(linear, wrapped):
    model, *batch = linear
    for name, call in CALLS.items():
        assert SENTENCE in refusal(call, wrapped(model), *batch), name
        assert refusal(call, model, *batch).startswith("nothing"), name
    SquareMoire(wrapped(model), scene=SCENE, steps=2)(*batch)


@pytest.mark.parametrize("head", [lambda z: z * 0, lambda z: z.round()])
def test_a_gradient_of_zeros_is_not_refused(linear, head):
    model, *batch = linear
    for name, call in CALLS.items():
        assert refusal(call, lambda x: head(model(x)), *batch).startswith("nothing"), name


def test_a_part_of_the_model_may_have_none(linear):
    model, images, labels = linear
    both = MoireAttack(lambda x: quantised(model)(x) * 0 + model(x), scene=SCENE, steps=2)
    whole = MoireAttack(model, scene=SCENE, steps=2)
    results = []
    for attack in (both, whole):
        results.append(attack(images, labels, generator=torch.Generator().manual_seed(1)))
    assert torch.equal(results[0].noise, results[1].noise)


def test_attacks_of_other_libraries_are_told(linear):
    model, images, _ = linear
    shot = SCENE.sample(3, (16, 16), torch.Generator().manual_seed(0))
    camera = Photographed(quantised(model), images, shot)
    loss = camera(camera.clean.clone().requires_grad_()).sum()
    with pytest.raises(ValueError, match=SENTENCE):
        loss.backward()


@pytest.mark.parametrize("by_reference", [False, True])
def test_a_photo_passes_no_gradient_on_as_none(linear, by_reference):
    """As torch's own operators do."""
    model, images, _ = linear
    shot = SCENE.sample(3, (16, 16), torch.Generator().manual_seed(0))
    images = images.clone().requires_grad_()
    with reference() if by_reference else contextlib.nullcontext():
        photo = capture(images, shot)
    quantised(model)(photo).sum().backward()
    assert images.grad is None
