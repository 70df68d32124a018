"""Keys of records: what they mean changes them, and nothing else does."""

import copy
import dataclasses
import functools
import os
import subprocess
import sys
import warnings

import numpy as np
import pytest
import torch
from torch import nn
from torchvision.transforms import v2

from moireaug import Scene
from moireaug.attacks import Normalized
from moireaug.defenses import JPEG, Compose, Defended
from moireaug.evaluation.attackers import MoireAttacker
from moireaug.evaluation.identity import digest, identity, require_identity
from moireaug.evaluation.judges import UNDEFENDED, Judge
from moireaug.evaluation.records import Records
from moireaug.evaluation.runner import Runner
from tests.evaluation.haze import CONDITIONS, EPS, SCENE, ran

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
    "until_fooled": False,
    "knows": Judge("j", defence=JPEG(60)),
    "variant": "other",
    "scene": Scene.preset("paper"),
}


@pytest.mark.parametrize("setting", CHANGES)
def test_a_key_changes_with_every_setting(known, setting):
    runner = ran(known)
    plain = CONDITIONS["ma"]
    assert runner.key(plain, UNDEFENDED, 0) in runner.records
    changed = dataclasses.replace(plain, **{setting: CHANGES[setting]})
    assert runner.key(changed, UNDEFENDED, 0) not in runner.records
    assert runner.key(plain, Judge("other"), 0) not in runner.records


def test_every_setting_of_an_attacker_is_tried():
    named = {field.name for field in dataclasses.fields(MoireAttacker)}
    assert named - {"place"} == set(CHANGES)


def test_a_defence_is_known_by_its_settings_and_weights():
    """Not by its name alone."""
    parts = [
        JPEG(60),
        JPEG(10),
        Compose((JPEG(60),)),
        Compose((classifier(0),)),
        Compose((classifier(1),)),
        classifier(0),
        torch.nn.functional.relu,
        torch.nn.functional.gelu,
        lambda x: x,
        lambda x: x + 1,
    ]
    found = [identity(part) for part in parts]
    assert len(set(found)) == len(parts)
    assert found[:5] == [identity(part) for part in parts[:5]]
    keys = {Judge("one", defence=part).identity for part in parts}
    assert len(keys) == len(parts)
    knowing = [
        MoireAttacker(eps=EPS, steps=2, knows=Judge("j", defence=part)) for part in parts[:2]
    ]
    assert knowing[0].settings() != knowing[1].settings()


def test_a_digest_sees_buffers_that_are_not_saved_and_layers_without_weights():
    net = classifier()
    grey, plain = Normalized(net, (0.5,) * 3, (0.5,) * 3), Normalized(net, (0.0,) * 3, (1.0,) * 3)
    assert digest(grey) != digest(plain)
    assert digest(nn.Sequential(net, nn.ReLU())) != digest(nn.Sequential(net, nn.GELU()))
    assert digest(classifier(0)) == digest(classifier(0)) != digest(classifier(1))


class Holds(nn.Module):
    def __init__(self, held):
        super().__init__()
        self.held = held


class Plain:
    def __init__(self, value):
        self._value = value

    def __call__(self, images):
        return images * self._value


def scaled(layer, images):
    return 2 * images


class Halved:
    def __call__(self, layer, images):
        return 0.5 * images


@dataclasses.dataclass(frozen=True)
class Loaded:
    """Keeps what it loads beside its fields."""

    file: str

    def __post_init__(self):
        object.__setattr__(self, "network", classifier(int(self.file)))


class Slotted:
    __slots__ = ("__gain", "mean")

    def __init__(self, gain):
        self.__gain = gain

    def __call__(self, images):
        return images * self.__gain


class Inherits(Slotted):
    """With a dict of its own, beside the slots."""


def named_alike(module):
    return type("Halved", (Plain,), {"__module__": module})(1.0)


def importable(source):
    """Return the function `restored` of a module with this text."""
    values = {"__name__": "restoring", "np": np, "network": classifier(0), "mean": torch.zeros(3)}
    exec(source, values)
    return values["restored"]


NETWORK = "def restored(images): return network(images)"
INNER = "def cleaned(images): return network(images)\ndef restored(images): return cleaned(images)"
COMPREHENSION = "def restored(images): return [network(one) for one in images]"


DECORATED = """
import functools
def by(gain):
    def around(function):
        @functools.wraps(function)
        def scaled(images):
            return gain * function(images)
        return scaled
    return around
@by({gain})
def restored(images):
    return images
"""


def swapped(source):
    """Return the same function twice, with other weights in the second module."""
    one, other = importable(source), importable(source)
    other.__globals__["network"] = classifier(1)
    return one, other


def hooked(hook):
    net = classifier()
    net[0].register_forward_pre_hook(hook)
    return net


def frozen(seed):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        return torch.jit.freeze(torch.jit.script(classifier(seed).eval()))


# what two models may differ in that is no weight, buffer or layer
DIFFER = {
    "a defence": (Defended(nn.Identity(), JPEG(20)), Defended(nn.Identity(), JPEG(80))),
    "a dict": ({"mean": 0.5}, {"mean": 0.4}),
    "an array": (np.zeros(2), np.ones(2)),
    "an array's shape": (np.zeros(2), np.zeros((2, 1))),
    "a tensor in bfloat16": (torch.ones(1, dtype=torch.bfloat16), torch.ones(1)),
    "a partial": (functools.partial(torch.clamp, min=0), functools.partial(torch.clamp, min=1)),
    "an object": (Plain(1.0), Plain(2.0)),
    "an object's method": (Plain(1.0).__call__, Plain(2.0).__call__),
    "a transform": (v2.Compose([v2.RandomErasing(0.1)]), v2.Compose([v2.RandomErasing(0.2)])),
    "an option": (v2.InterpolationMode.BILINEAR, v2.InterpolationMode.NEAREST),
    "a set": ({"a", "b", "c"}, {"a", "b", "d"}),
    "networks in a list": ([classifier(0)], [classifier(1)]),
    "a function": (torch.relu, torch.sigmoid),
    "a hook": (hooked(scaled), hooked(Halved())),
    "what a dataclass loads": (Loaded("0"), Loaded("1")),
    "the module of a class": (named_alike("one"), named_alike("other")),
    "the network that a function names": swapped(NETWORK),
    "one named by a function that it calls": swapped(INNER),
    "one named in a comprehension": swapped(COMPREHENSION),
    "a number that a function names": (
        importable("gain = 1.5\ndef restored(images): return gain * images"),
        importable("gain = 2.5\ndef restored(images): return gain * images"),
    ),
    "a slot": (Slotted(1.0), Slotted(2.0)),
    "an inherited slot": (Inherits(1.0), Inherits(2.0)),
    "a sparse tensor": (torch.eye(2).to_sparse(), (2 * torch.eye(2)).to_sparse()),
    "a conjugate": (torch.ones(2, dtype=torch.cfloat).conj(), 2j * torch.ones(2).cfloat().conj()),
    "a default": (
        importable("def restored(images, gain=1.5): return gain * images"),
        importable("def restored(images, gain=2.5): return gain * images"),
    ),
    "what a decorator encloses": (
        importable(DECORATED.format(gain=1.5)),
        importable(DECORATED.format(gain=2.5)),
    ),
}


@pytest.mark.parametrize("what", DIFFER)
def test_models_are_told_apart_by(what):
    one, other = DIFFER[what]
    assert identity(one) == identity(copy.deepcopy(one)) != identity(other)
    assert digest(Holds(one)) == digest(Holds(copy.deepcopy(one))) != digest(Holds(other))
    require_identity("it", Holds(one))


@pytest.mark.parametrize("hide", [lambda f: f, Plain, lambda f: Holds([f]), lambda f: {"act": f}])
def test_what_holds_a_lambda_is_refused_where_records_are_kept(hide):
    with pytest.raises(ValueError, match="nothing tells the model, a Holds that is or holds a lam"):
        require_identity("the model", Holds(hide(lambda images: images)))


@pytest.mark.parametrize("held", [lambda script: script, nn.Sequential, lambda script: [script]])
def test_a_frozen_script_is_known_by_its_constants(held):
    one, other = held(frozen(0)), held(frozen(1))
    assert digest(one) == digest(one) != digest(other)


def test_a_compiled_model_is_told_by_what_it_was_made_of():
    one, other = (torch.compile(classifier(seed), backend="eager") for seed in (0, 1))
    before = digest(one)
    one(torch.rand(1, 3, 16, 16))
    assert digest(one) == before != digest(other)
    require_identity("it", one)


def test_another_process_tells_the_same_of_a_set():
    told = []
    for hashes in ("1", "2"):
        program = "from moireaug.evaluation.identity import identity; print(identity({*'abcdef'}))"
        env = os.environ | {"PYTHONHASHSEED": hashes}
        done = subprocess.run([sys.executable, "-c", program], env=env, capture_output=True)
        told.append(done.stdout)
    assert told[0] == told[1] != b""


def test_a_model_whose_weights_are_not_there_yet_has_a_digest():
    assert digest(nn.LazyLinear(2)) == digest(nn.LazyLinear(2)) != digest(nn.LazyLinear(3))


def test_what_an_object_keeps_once_computed_does_not_tell_it_from_itself():
    judge = Judge("j", defence=JPEG(60))
    before = identity(judge)
    assert judge.identity and identity(judge) == before


def test_what_holds_itself_has_an_end():
    model = Holds(None)
    model.held = Plain([model])
    assert digest(model) == digest(copy.deepcopy(model))


def test_a_key_changes_with_model_scene_and_pixels(known):
    model, batches = known
    runner = ran(known)
    plain = CONDITIONS["ma"]
    key = runner.key(plain, UNDEFENDED, 0)
    assert Runner(model, batches, SCENE, Records(), seed=3).key(plain, UNDEFENDED, 0) == key
    others = [
        Runner(classifier(1), batches, SCENE, Records(), seed=3),
        Runner(model, batches, Scene.preset("phone_at_laptop"), Records(), seed=3),
        Runner(model, [(x * 0.5, y) for x, y in batches], SCENE, Records(), seed=3),
        Runner(model, [(x, (y + 1) % 4) for x, y in batches], SCENE, Records(), seed=3),
        Runner(torch.relu, batches, SCENE, Records(), seed=3),
        Runner(torch.sigmoid, batches, SCENE, Records(), seed=3),
    ]
    keys = {key, *(other.key(plain, UNDEFENDED, 0) for other in others)}
    assert len(keys) == 1 + len(others)
