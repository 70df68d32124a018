"""Settings and input that no attack takes, and what each is told."""

import copy
import math

import numpy as np
import pytest
from torch import nn

from moireaug.attacks import CW, PGD, MoireAttack, MultiTargeted, Normalized, Patch, SquareMoire
from moireaug.transforms import AdversarialMoire
from tests.attacks.common import SCENE, refusal


class Elsewhere(nn.Linear):
    """Says what torch says of images on another device."""

    def __init__(self):
        super().__init__(1, 1)

    def forward(self, x):
        kinds = "Input type (torch.FloatTensor) and weight type (torch.cuda.FloatTensor)"
        raise RuntimeError(f"{kinds} should be the same")


BAD = [
    (lambda m, x, y: MoireAttack(None), "logits (B, K); got None"),
    (lambda m, x, y: CW(None), "logits (B, K); got None"),
    (lambda m, x, y: PGD(nn.Linear), "logits (B, K); got <class"),
    (lambda m, x, y: MoireAttack(m, eps=math.nan), "eps must be a number >= 0"),
    (lambda m, x, y: MoireAttack(m, eps=True), "eps must be a number >= 0"),
    (lambda m, x, y: PGD(m, eps=[0.1, 0.2]), "got [0.1, 0.2]. Make one attack per value."),
    (lambda m, x, y: PGD(m, eps=np.array([0.1])), "Make one attack per value."),
    (lambda m, x, y: MoireAttack(m, eps=4), "Divide by 255?"),
    (lambda m, x, y: MoireAttack(m, steps=-1), "steps must be a whole number of at least 0"),
    (lambda m, x, y: MoireAttack(m, restarts=0), "restarts must be a whole number of at least 1"),
    (lambda m, x, y: MoireAttack(m, eot=0), "eot must be a whole number of at least 1"),
    (lambda m, x, y: MoireAttack(m, step_size=0), "step_size must be a finite number above 0"),
    (
        lambda m, x, y: PGD(m, random_start=math.inf),
        "must be a finite number of at least 0",
    ),
    (lambda m, x, y: MoireAttack(m, steps=2, random_start=2.0), "for a single step"),
    (lambda m, x, y: MoireAttack(m, loss="margins"), "Did you mean 'margin'?"),
    (lambda m, x, y: MoireAttack(m, scene="papers"), "Did you mean 'paper'?"),
    (lambda m, x, y: MoireAttack(m, rule="signs"), "Did you mean 'sign'?"),
    (lambda m, x, y: MoireAttack(m, noise_at="raws"), "Did you mean 'raw'?"),
    (lambda m, x, y: MoireAttack(m, rule="printed", eot=2), "needs eot = 1"),
    (lambda m, x, y: MoireAttack(m, rule="printed", optimise=("view",)), "adds to the reading"),
    (lambda m, x, y: PGD(m, rule="printed"), "a pixel attack has none"),
    (lambda m, x, y: PGD(lambda i: m(i)[:, :2], loss="dlr")(x, y * 0), "at least 3 classes; got"),
    (lambda m, x, y: PGD(lambda i: m(i)[:, :3], loss="dlr")(x, y * 0, y * 0 + 1), "4 classes; got"),
    (lambda m, x, y: SquareMoire(m, rule="momentum"), "no use for rule = 'momentum'"),
    (lambda m, x, y: SquareMoire(m, step_size=0.1), "no use for step_size"),
    (lambda m, x, y: SquareMoire(m, eot=2), "no use for eot"),
    (lambda m, x, y: SquareMoire(m)(x, y + 5), "the model's classes; got"),
    (lambda m, x, y: SquareMoire(lambda i: m(i).long())(x, y), "point; got torch.int64"),
    (
        lambda m, x, y: CW(m, binary_search_steps=0),
        "must be a whole number of at least 1",
    ),
    (lambda m, x, y: CW(m, c=0), "c must be a finite number above 0"),
    (lambda m, x, y: CW(m, c=True), "c must be a finite number above 0; got True"),
    (lambda m, x, y: CW(m, lr=math.nan), "lr must be a finite number above 0"),
    (lambda m, x, y: CW(m, confidence="1"), "confidence must be a finite number of at least 0"),
    (lambda m, x, y: CW(m, steps=1.5), "steps must be a whole number of at least 0"),
    (lambda m, x, y: Patch(m, area="a"), "area must be the disc's share"),
    (lambda m, x, y: MultiTargeted(m), "whose steps have a target, like MoireAttack"),
    (
        lambda m, x, y: MultiTargeted(PGD(m), targets=0),
        "must be a whole number of at least 1",
    ),
    (lambda m, x, y: PGD(lambda i: m(i)[:, :1])(x, y * 0), "single logit z of a binary"),
    (lambda m, x, y: CW(m)(x, y, shot=SCENE.sample(6, (16, 16))), "no camera"),
    (lambda m, x, y: CW(m)(x, y + 5), "the model's classes; got"),
    (lambda m, x, y: CW(m, steps=0)(x, y + 5), "the model's classes; got"),
    (lambda m, x, y: CW(m)(x, y[:2]), "shape (6,)"),
    (lambda m, x, y: PGD(m)(x, y + 5), "[0, 4], the model's classes; got"),
    (lambda m, x, y: PGD(m)(x, y - 9), "class indices >= 0"),
    (lambda m, x, y: PGD(m)(x, y.float()), "integer tensor"),
    (lambda m, x, y: PGD(m)(x, y[:2]), "shape (6,)"),
    (lambda m, x, y: PGD(m)(x, y, y + 7), "the model's classes"),
    (lambda m, x, y: PGD(m)(x * 255, y), "lie in [0, 1]"),
    (lambda m, x, y: MoireAttack(m, scene=SCENE).last(x * 255, y), "Divide them by 255"),
    (lambda m, x, y: PGD(m)(x, y, shot=SCENE.sample(6, (16, 16))), "no camera"),
    (lambda m, x, y: MoireAttack(m)(x, y, shot=SCENE.sample(2, (16, 16))), "drawn for 2 images"),
    (lambda m, x, y: PGD(lambda i: i)(x, y), "must return logits (B, K)"),
    (lambda m, x, y: AdversarialMoire(m, p=2), "p must be a probability"),
    (lambda m, x, y: Normalized(m, std=(0.1, 0.0, 0.1)), "every std must be above 0"),
    (lambda m, x, y: Normalized(m, mean=(math.nan,) * 3), "3 for the channels or 1 for all"),
    (lambda m, x, y: Normalized(m, 0.5, 0.25), "be a list of finite numbers"),
    (lambda m, x, y: PGD(copy.deepcopy(m).half())(x, y), "has weights of torch.float16 and does"),
    (lambda m, x, y: CW(copy.deepcopy(m).bfloat16())(x, y), "model(images.to(torch.bfloat16))"),
    (lambda m, x, y: PGD(m)(x.double(), y), "model(images.to(torch.float32))"),
    (lambda m, x, y: PGD(m)(x[:, :1], y), "Show grey images as RGB, images.expand(-1, 3, -1, -1)"),
    (lambda m, x, y: PGD(nn.Conv2d(1, 5, 16))(x, y), "model(rgb_to_grayscale(images))"),
    (lambda m, x, y: PGD(m)(x, np.arange(6, dtype=np.uint16) + 7), "the model's classes; got 12"),
    (lambda m, x, y: PGD(m)(x, np.zeros(6, complex)), "must be an integer tensor or array"),
    (lambda m, x, y: PGD(m)(x, np.array(["a"] * 6)), "must hold numbers; got an array of <U1"),
    (lambda m, x, y: PGD(Elsewhere())(x, y), "is on cpu and does not take these images (Input"),
    (lambda m, x, y: PGD(Elsewhere())(x, y), "should be the same): pass images.to('cpu')."),
]


def test_wrong_input_gets_a_sentence(model, batch):
    for do, sentence in BAD:
        assert sentence in refusal(do, model, *batch)


def test_the_models_own_mistake_is_not_blamed_on_images(model, batch):
    def mixed(x):
        return model(x) + nn.functional.linear(x.flatten(1), x.new_ones(5, 768).double())

    with pytest.raises(RuntimeError, match="same dtype"):
        PGD(mixed)(*batch)


def test_numpys_integers_count():
    """A sweep over np.arange passes them."""
    model = Normalized(nn.Flatten())
    for kind in (np.int64, np.uint8):
        assert MoireAttack(model, eot=kind(2), steps=kind(1), restarts=kind(1)).eot == 2
        assert CW(model, steps=kind(3)).steps == 3
        assert MultiTargeted(PGD(model), targets=kind(2)).targets == 2
