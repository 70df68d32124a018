"""What the tests of attacks share: a scene, a bound, and a model's decisions."""

import warnings

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, attacks
from moireaug.attacks import BIM, CW, MIFGSM, PGD, MoireAttack, MultiTargeted, Patch, SquareMoire

SCENE = Scene(
    panel=Panel(scale=1.1),
    view=View(roll=(-5, 5)),
    lens=Lens(blur=0.25),
    sensor=Sensor(scale=2.0, gain=2.0),
    develop=Develop(brighten=0.1),
)
EPS = 4 / 255

METHODS = {
    "ma": (MoireAttack, {}),
    "ma margin": (MoireAttack, {"loss": "margin"}),
    "ma restarts": (MoireAttack, {"restarts": 2, "random_start": 1.0}),
    "ma eot": (MoireAttack, {"eot": 2}),
    "ma paper_code": (MoireAttack, {"scene": "paper_code"}),
    "ma dlr": (MoireAttack, {"loss": "dlr"}),
    "ma momentum": (MoireAttack, {"rule": "momentum"}),
    "ma apgd": (MoireAttack, {"rule": "apgd", "restarts": 2}),
    "ma printed": (MoireAttack, {"rule": "printed"}),
    "ma photo": (MoireAttack, {"noise_at": "photo"}),
    "ma turned": (MoireAttack, {"optimise": ("noise", "view")}),
    "ma pose": (MoireAttack, {"optimise": ("view",), "rule": "apgd"}),
    "ma until fooled": (MoireAttack, {"restarts": 2, "until_fooled": True}),
    "pgd": (PGD, {}),
    "pgd margin": (PGD, {"loss": "margin"}),
    "bim": (BIM, {}),
    "mifgsm": (MIFGSM, {}),
    "cw": (CW, {}),
    "patch": (Patch, {"area": 0.1}),
    "square": (SquareMoire, {}),
    "square until fooled": (SquareMoire, {"until_fooled": True}),
    "square photo": (SquareMoire, {"noise_at": "photo"}),
}


def attack_by(method, model, steps=2):
    """The attack of a name in METHODS, or, where "toward" stands before it, toward two classes."""
    kind, settings = METHODS[method.removeprefix("toward ")]
    defaults = {} if kind is CW else {"eps": EPS}
    if issubclass(kind, MoireAttack):
        defaults["scene"] = SCENE
    attack = kind(model, **defaults | settings, steps=steps)
    return MultiTargeted(attack, targets=2) if method.startswith("toward ") else attack


def striped(n, generator):
    """n images, (n, 3, 16, 16), and their labels: a class is where a column is dark."""
    images, labels = torch.rand(n, 3, 16, 16, generator=generator), torch.arange(n) % 5
    images[torch.arange(n), 0, :, labels * 3] *= 0.3
    return images, labels


def quietly(name):
    """A library of attacks, or a skipped test; its imports warn of other libraries' future."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pytest.importorskip(name)


def predicted(model, images):
    with attacks.evaluating(model), torch.no_grad():
        return model(images).argmax(1)


def refusal(call, *arguments):
    """The sentence that a call is refused with."""
    try:
        call(*arguments)
    except (ValueError, TypeError) as error:
        return str(error)
    return "nothing: the call was taken"


def counting(model):
    """(the same model, asked), the number of images of each question."""
    asked = []

    def answer(images):
        asked.append(len(images))
        return model(images)

    return answer, asked
