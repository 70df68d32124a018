"""Keys of records: what they mean changes them, and nothing else does."""

import copy
import dataclasses
import functools
import warnings

import numpy as np
import pytest
import torch
from torch import nn
from torchvision.transforms import v2

from moireaug import Scene
from moireaug.attacks import Normalized
from moireaug.defenses import JPEG, Compose, Defended, PixelDeflection, Quilting
from moireaug.evaluation.attackers import MoireAttacker, PhotoUnknownAttacker
from moireaug.evaluation.classifiers import UNDEFENDED, Classifier
from moireaug.evaluation.identity import identity_of, require_identity
from moireaug.evaluation.records import EvalSetup, Records
from moireaug.evaluation.runner import Runner
from tests.evaluation.haze import CONDITIONS, EPS, SCENE, ran, table_of

from .conftest import classifier

CHANGES = {
    "steps": 3,
    "eps": EPS / 2,
    "restarts": 2,
    "targeted": True,
    "rule": "apgd",
    "loss": "margin",
    "noise_at": "photo",
    "optimise": ("noise", "view"),
    "draws": 3,
    "until_fooled": False,
    "known_classifier": Classifier("j", defence=JPEG(60)),
    "variant": "other",
    "scene": Scene.preset("paper"),
}


def test_a_key_changes_with_every_setting(known):
    plain = CONDITIONS["ma"]
    runner = ran(known, table_of(plain), (0,))
    assert runner.key(plain, UNDEFENDED, 0) in runner.records
    assert runner.key(plain, Classifier("other"), 0) not in runner.records
    for setting, value in CHANGES.items():
        changed = dataclasses.replace(plain, **{setting: value})
        assert runner.key(changed, UNDEFENDED, 0) not in runner.records, setting
    named = {field.name for field in dataclasses.fields(MoireAttacker)}
    assert named - {"scene_name"} == set(CHANGES)  # each was tried


def test_a_key_changes_with_the_draws_of_an_expectation():
    attackers = [PhotoUnknownAttacker(eps=EPS, steps=2, shots=shots) for shots in (4, 8)]
    for draws in (1, 20):
        classifier = Classifier("j", PixelDeflection(), draws=draws)
        attackers.append(MoireAttacker(eps=EPS, steps=2, known_classifier=classifier))
    assert len({str(attacker.settings()) for attacker in attackers}) == 4


def test_a_classifier_is_known_by_what_it_holds_and_where():
    """Not by its name alone."""
    parts = [JPEG(60), JPEG(10), Compose((JPEG(60),)), classifier(0), lambda x: x, lambda x: x + 1]
    assert len({identity_of(part) for part in parts}) == len(parts)
    keys = {Classifier("one", defence=part).identity for part in parts}
    keys |= {Classifier("one", model=part).identity for part in parts}
    assert len(keys) == 2 * len(parts)


class Holds(nn.Module):
    def __init__(self, part):
        super().__init__()
        self.part = part


class Plain:
    """An object of the user's, with or without an identity."""

    def __init__(self, value, identity=None):
        self.value = value
        if identity is not None:
            self.identity = identity

    def __call__(self, images):
        return images * self.value


@dataclasses.dataclass(frozen=True)
class Loaded:
    """Keeps what it loads beside its fields."""

    file: str

    def __post_init__(self):
        object.__setattr__(self, "network", classifier(int(self.file)))


@dataclasses.dataclass(frozen=True, slots=True)
class Slotted:
    gain: float


def frozen(seed):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        return torch.jit.freeze(torch.jit.script(classifier(seed).eval()))


# what two models may differ in that is no weight, buffer or layer
DIFFERENCES = {
    "a defence": (Defended(nn.Identity(), JPEG(20)), Defended(nn.Identity(), JPEG(80))),
    "a layer without weights": (nn.Sequential(nn.ReLU()), nn.Sequential(nn.GELU())),
    "a buffer that no file holds": (Normalized(classifier()), Normalized(classifier(), (0.0,) * 3)),
    "weights": (classifier(0), classifier(1)),
    "a dict": ({"mean": 0.5}, {"mean": 0.4}),
    "an array": (np.zeros(2), np.ones(2)),
    "an array's shape": (np.zeros(2), np.zeros((2, 1))),
    "a number of NumPy's": (np.float32(1), np.float32(2)),
    "a tensor in bfloat16": (torch.ones(1, dtype=torch.bfloat16), torch.ones(1)),
    "a dtype": (torch.float32, torch.float64),
    "a partial": (functools.partial(torch.clamp, min=0), functools.partial(torch.clamp, min=1)),
    "a transform": (v2.Compose([v2.RandomErasing(0.1)]), v2.Compose([v2.RandomErasing(0.2)])),
    "an option": (v2.InterpolationMode.BILINEAR, v2.InterpolationMode.NEAREST),
    "a set": ({"a", "b", "c"}, {"a", "b", "d"}),
    "the nesting of lists": ([[1], 2], [[1, 2]]),
    "the quotes of a text": (["a', 'b"], ["a", "b"]),
    "networks in a list": ([classifier(0)], [classifier(1)]),
    "a function of torch's": (torch.relu, torch.sigmoid),
    "a class": (nn.BatchNorm2d, nn.LayerNorm),
    "what a dataclass loads": (Loaded("0"), Loaded("1")),
    "a dataclass with slots": (Slotted(1.0), Slotted(2.0)),
    "a sparse tensor": (torch.eye(2).to_sparse(), (2 * torch.eye(2)).to_sparse()),
    "a conjugate": (torch.ones(2, dtype=torch.cfloat).conj(), 2j * torch.ones(2).cfloat().conj()),
    "a stated identity": (Plain(1.0, "v1"), Plain(1.0, "v2")),
    "one in bytes": (Plain(1.0, b"v1"), Plain(1.0, "v1")),
}


def test_models_are_told_apart_by_what_they_hold():
    for name, (one, other) in DIFFERENCES.items():
        copied = copy.deepcopy(one)
        assert identity_of(one) == identity_of(copied) != identity_of(other), name
        assert identity_of(Holds(one)) == identity_of(Holds(copied)), name
        assert identity_of(Holds(one)) != identity_of(Holds(other)), name
        require_identity("it", Holds(one))


def hooked():
    net = classifier()
    net[0].register_forward_pre_hook(lambda layer, images: 2 * images[0])
    return net


def patched():
    net = classifier()
    net.forward = lambda images: images
    return net


def holding_itself():
    model = Holds(None)
    model.part = [model]
    return model


def scaled(images):
    return 2 * images


# what holds more than weights and plain settings: a function may name and enclose anything
UNIDENTIFIED = {
    "a lambda": lambda: lambda images: images,
    "a function of the user's": lambda: scaled,
    "one in a partial": lambda: functools.partial(scaled),
    "one in a dict": lambda: Holds({"act": scaled}),
    "one in a defence": lambda: Compose((scaled,)),
    "an object": lambda: Plain(1.0),
    "its method": lambda: Plain(1.0).__call__,
    "an object in a list": lambda: Holds([Plain(1.0)]),
    "an array of objects": lambda: Holds(np.array([scaled])),
    "a hook": hooked,
    "a forward of its own": patched,
    "a module that holds itself": holding_itself,
    "weights that are not there yet": lambda: nn.LazyLinear(2),
}


def test_other_objects_are_refused_where_records_are_kept():
    """And are but themselves where they are not."""
    for name, make in UNIDENTIFIED.items():
        one, other = make(), make()
        assert identity_of(one) == identity_of(one), name
        assert one is other or identity_of(one) != identity_of(other), name
        with pytest.raises(ValueError, match=r"nothing tells it, a .* or holds a .*identity=\.\."):
            require_identity("it", one)


def test_a_stated_identity_stands_for_settings_beside_the_weights():
    one, same, other = Holds(scaled), Holds(scaled), nn.Sequential(classifier(1))
    for part in (one, same):
        part.net = classifier(0)
    assert identity_of(one) != identity_of(same)
    assert identity_of(one, "v1") == identity_of(same, "v1") != identity_of(one, "v2")
    one.identity = same.identity = other.identity = "v1"
    assert identity_of(one) == identity_of(same) == identity_of(one, "v1")
    same.net = classifier(1)
    assert len({identity_of(part) for part in (one, same, other)}) == 3
    require_identity("it", one)


def test_a_frozen_script_is_known_by_its_constants():
    scripts = frozen(0), frozen(1)
    for hold in (lambda script: script, nn.Sequential, lambda script: [script]):
        one, other = map(hold, scripts)
        assert identity_of(one) == identity_of(one) != identity_of(other)
        require_identity("it", one)


def test_a_compiled_model_is_known_by_its_original():
    one, other = (torch.compile(classifier(seed), backend="eager") for seed in (0, 1))
    before = identity_of(one)
    one(torch.rand(1, 3, 16, 16))
    assert identity_of(one) == before != identity_of(other)
    require_identity("it", one)
    in_place = classifier()
    in_place.compile(backend="eager")
    assert identity_of(in_place) == identity_of(classifier())


def test_what_is_computed_once_is_no_part_of_identity():
    quilting = Quilting(torch.rand(4, 3, 5, 5))
    before = identity_of(quilting)
    quilting(torch.rand(1, 3, 8, 8))
    assert identity_of(quilting) == before


def test_a_key_changes_with_model_scene_pixels_and_classifier(known):
    model, batches = known

    def key(model=model, batches=batches, scene=SCENE, seed=3, classifier=UNDEFENDED):
        runner = Runner(model, batches, EvalSetup(scene, seed), Records())
        return runner.key(CONDITIONS["ma"], classifier, 0)

    assert key() == key(copy.deepcopy(model))
    keys = [
        key(),
        key(classifier(1)),
        key(scene=Scene.preset("phone_at_laptop")),
        key(batches=[(x * 0.5, y) for x, y in batches]),
        key(batches=[(x, (y + 1) % 4) for x, y in batches]),
        key(batches=[(x.view(8, 3, 8, 32), y) for x, y in batches]),
        key(torch.relu),
        key(torch.sigmoid),
        key(seed=4),
        key(classifier=Classifier("mine", defence=JPEG(20))),
        key(classifier=Classifier("mine", defence=JPEG(80))),
        key(classifier=Classifier("mine")),
        key(classifier=Classifier("mine", restores_mean=True)),
    ]
    assert len(set(keys)) == len(keys)
