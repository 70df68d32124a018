"""Classifiers to train and to attack, by name: compact networks for small images, and every
torchvision classifier."""

import difflib
import functools
import textwrap
from collections.abc import Callable, Mapping
from functools import partial
from types import ModuleType

import torch
from torch import Tensor, nn

from moireaug.attacks import Normalized
from moireaug.common.networks import in_evaluation_mode
from moireaug.common.weights import read_state_dict, without_wrappers
from training.models.small_convnet import AttentionConvNet
from training.models.small_resnet import SmallResNet

# the project's own models, each a function of the number of classes
OWN_MODELS: dict[str, Callable[[int], nn.Module]] = {
    "attention_convnet": AttentionConvNet,
    "attention_resnet": partial(SmallResNet, width=32, activation=nn.SiLU, heads=4),
    "small_resnet": SmallResNet,
}
# The auxiliary heads serve training from scratch in the original recipes, and turn the output into
# a tuple. transform_input undoes the ImageNet normalisation that every other torchvision model
# expects, in favour of their own.
_SINGLE_OUTPUT = {"aux_logits": False, "transform_input": True, "init_weights": True}
_EXTRA = {"googlenet": _SINGLE_OUTPUT, "inception_v3": _SINGLE_OUTPUT}
_AUXILIARY = ("aux1.", "aux2.", "AuxLogits.")
MAX_PROBLEMS, MAX_PROBLEM_CHARACTERS = 3, 160  # of torch's message on weights that do not fit


def as_model(
    name: str, num_classes: int, weights: str | None = None, *, whole: bool = False
) -> nn.Module:
    """Return a classifier of [0, 1] images by name, freshly initialised or with weights;
    torchvision's models get their ImageNet normalisation put inside.

    Args:
        name: name among `OWN_MODELS`, or any torchvision classifier.
        weights: file that `moireaug.common.weights.read_state_dict` reads, or name of torchvision
            weights such as "IMAGENET1K_V1" or "DEFAULT". Of weights for another number of classes,
            the head is left out and stays freshly initialised.
        whole: whether to refuse weights for another number of classes: a model with a fresh head
            cannot be evaluated.
    """
    require_known(name)
    model = _fresh(name, num_classes)
    if weights is not None:
        complaint = f"The weights {weights!r} do not fit {name!r} with {num_classes} classes"
        _load(model, name, _state(name, weights), complaint, whole=whole)
    # in this layout convolutions are up to twice as fast on CPU
    model = model.to(memory_format=torch.channels_last)
    return model if name in OWN_MODELS else Normalized(model)


def check_side(model: nn.Module, name: str, side: int) -> None:
    """Refuse images that are too small, or of another size than a model's own."""
    weight = next(model.parameters())
    try:
        with torch.no_grad(), in_evaluation_mode(model):
            model(weight.new_zeros(1, 3, side, side))
    except (RuntimeError, AssertionError, ValueError) as error:
        why = str(error).splitlines()[0]
        raise ValueError(
            f"{name} cannot take images of {side} x {side} pixels ({why}): pass another data.size, "
            "224 for most of torchvision's models, or another model."
        ) from error


def _torchvision() -> ModuleType:
    """Return torchvision's models, which take seconds to import."""
    import torchvision

    return torchvision.models


def model_names() -> list[str]:
    """Return every name that `as_model` knows, own models first."""
    models = _torchvision()
    return [*OWN_MODELS, *models.list_models(module=models)]


def class_names(name: str) -> dict[int, str]:
    """Return the names of the classes that a torchvision model was published with; empty for a
    model of our own."""
    if name in OWN_MODELS:
        return {}
    published = _torchvision().get_model_weights(name).DEFAULT
    return dict(enumerate(published.meta.get("categories", ())))


def class_count(name: str, state: Mapping[str, Tensor]) -> int:
    """Return the number of logits of a state of this model; 0 where it lacks the head's weights."""
    head = _head_of(name)
    # as in the model, in one that `Normalized` wraps, and as `read_state_dict` names it
    names = (head, f"model.{head}", *without_wrappers({head: head}))
    weight = next((state[key] for key in names if key in state), None)
    return 0 if weight is None or not weight.dim() else len(weight)


@functools.cache
def _head_of(name: str) -> str:
    """Return the key of a tensor whose length is the number of classes: in some networks it is not
    the last one."""
    with torch.random.fork_rng(devices=[]):
        try:
            with torch.device("meta"):  # without memory
                two, three = (_fresh(name, classes).state_dict() for classes in (2, 3))
        except NotImplementedError:  # its constructor computes with tensors
            two, three = (_fresh(name, classes).state_dict() for classes in (2, 3))
    return next(key for key in two if two[key].dim() and len(two[key]) != len(three[key]))


def class_count_of(name: str, weights: str) -> int:
    """Return the number of logits of a model's weights, given as in `as_model`; weights without a
    head are refused."""
    count = class_count(name, _state(name, weights))
    if not count:
        raise ValueError(
            f"The weights {weights!r} lack the last layer of {name!r}, {_head_of(name)}: pass the "
            "model that they were saved from, with all of its weights."
        )
    return count


def require_known(name: str) -> None:
    """Refuse a name that no model has."""
    if name not in OWN_MODELS and name not in model_names():
        closest = difflib.get_close_matches(name, model_names(), n=3, cutoff=0.3)
        hint = f" Closest: {', '.join(closest)}." if closest else ""
        raise ValueError(
            f"There is no model named {name!r}.{hint} "
            f"Pass {', '.join(map(repr, OWN_MODELS))}, or a name from "
            "torchvision.models.list_models(module=torchvision.models)."
        )


def _fresh(name: str, num_classes: int) -> nn.Module:
    if name in OWN_MODELS:
        return OWN_MODELS[name](num_classes)
    return _torchvision().get_model(name, num_classes=num_classes, **_EXTRA.get(name, {}))


def _state(name: str, weights: str) -> Mapping[str, Tensor]:
    """Return a state_dict by the name of published weights, or out of a file, without auxiliary
    heads."""
    published = _published_names(name)
    if weights in published:
        state = _published(name, weights)
    else:
        published_hint = f", or one of {', '.join(published)}" if published else ""
        advice = f"Pass a file that torch.save(model.state_dict(), path) wrote{published_hint}."
        state = read_state_dict(weights, name, advice)
    return {key: value for key, value in state.items() if not key.startswith(_AUXILIARY)}


def _published_names(name: str) -> list[str]:
    if name in OWN_MODELS:
        return []
    return list(_torchvision().get_model_weights(name).__members__)


def _published(name: str, weights: str) -> Mapping[str, Tensor]:
    """Return the state of torchvision's own model with these weights, downloaded once into the
    torch hub folder."""
    try:
        return _torchvision().get_model(name, weights=weights).state_dict()
    except (OSError, RuntimeError) as error:
        raise ValueError(
            f"The torchvision weights {weights!r} of {name!r} could not be fetched ({error}). "
            "Check the network, or pass the path of a downloaded state_dict file."
        ) from error


def _load(
    model: nn.Module, name: str, state: Mapping[str, Tensor], complaint: str, *, whole: bool
) -> None:
    """Copy a state into a model, except for a head made for another number of classes."""
    expected = model.state_dict()
    # a model of one's own may itself keep all layers in an attribute named as a wrapper's
    full_names = without_wrappers({key: key for key in expected})
    state = {full_names.get(key, key): value for key, value in state.items()}
    common = [key for key in state if key in expected]
    reshaped = [key for key in common if state[key].shape != expected[key].shape]
    if reshaped and not whole and _is_head(name, reshaped, expected, state):
        state = {**state, **{key: expected[key] for key in reshaped}}
    try:
        model.load_state_dict(state)
    except RuntimeError as error:
        problems = [
            textwrap.shorten(line, MAX_PROBLEM_CHARACTERS, placeholder=" ...")
            for line in str(error).splitlines()[1 : 1 + MAX_PROBLEMS]
        ]
        advice = "; only the number of classes may differ."
        if whole:
            advice = " and its classes; data.class_index maps a folder's classes to them."
        raise ValueError(
            f"{complaint}: {' '.join(problems)} Pass the model that they were saved from{advice}"
        ) from error


def _is_head(
    name: str, reshaped: list[str], expected: Mapping[str, Tensor], state: Mapping[str, Tensor]
) -> bool:
    """Return whether the tensors that changed shape are the head's, and only in their number of
    outputs."""
    head = _head_of(name).rpartition(".")[0]
    if set(reshaped) != {key for key in expected if key.rpartition(".")[0] == head}:
        return False
    shapes = [(state[key].shape, expected[key].shape) for key in reshaped]
    return all(len(got) == len(own) and got[1:] == own[1:] for got, own in shapes)
