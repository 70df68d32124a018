"""The networks that a model computes with, and their modes."""

from __future__ import annotations

import contextlib
import functools
import itertools
import types
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from moireaug.callables import enclosed_values, named_globals

MAX_ITEMS = 1000  # of a container that is searched; a longer one holds data
MODULE_TABLES = frozenset(vars(nn.Module()))  # of every module: its mode, hooks and parts


@contextlib.contextmanager
def in_evaluation_mode(model: object) -> Iterator[None]:
    """Put the networks of a model into evaluation mode, and each module back into its own mode on
    exit, also after an error.

    BatchNorm would otherwise update its statistics from images that are not the user's. Modes are
    entered and left through `Module.train`, so that a module that does more there than set a flag,
    such as one that merges its low-rank weights, ends as it began.

    Args:
        model: a module, or any callable. The modes that change are those of its networks as
            `networks_of` finds them. Others keep theirs, such as a network that the code looks up
            in an object that cannot be called, imports or loads when it runs: call its `eval()`
            yourself. So do modules that refuse a change of mode, as exported graphs do.
    """
    modes = _modes_of(networks_of(model))
    try:
        _enter_evaluation(modes)
        yield
    finally:
        _restore(modes)


def _modes_of(networks: Sequence[nn.Module]) -> dict[nn.Module, bool]:
    """Return whether each module of some networks is in training, parents before their children."""
    modes = {}
    for network in networks:
        for module in network.modules():
            if hasattr(module, "training"):  # which TorchScript's frozen modules lack
                modes[module] = module.training
    return modes


def _enter_evaluation(modes: Mapping[nn.Module, bool]) -> None:
    """Put the outermost of the modules in training into evaluation, and with them those inside."""
    entered: set[nn.Module] = set()
    for module, training in modes.items():
        if not training or module in entered:
            continue
        try:
            module.eval()
        except Exception:  # which one depends on the module: exported graphs have no mode to change
            continue
        entered.update(module.modules())


def _restore(modes: Mapping[nn.Module, bool]) -> None:
    """Put modules back into training (True) or evaluation (False), parents before their children,
    which leave their parents' mode for their own."""
    for module, training in modes.items():
        if module.training != training:
            with contextlib.suppress(Exception):  # it has changed only half of its modules
                module.train(training)
            module.training = training  # where its own `train` would keep it in another mode


def networks_of(model: object) -> list[nn.Module]:
    """Return the modules that a model computes with, each once, without their submodules.

    Followed are bound methods to their object, partial functions, a function's closure, defaults
    and the globals that it names, the attributes of callable objects, what a module holds beside
    its submodules, and lists, tuples and dicts of these. Not followed are objects that cannot be
    called, other than a method's own, and what code imports, looks up or makes when it runs.
    """
    networks: list[nn.Module] = []
    seen: set[int] = set()
    queue: list[Any] = [model]
    for part in queue:  # which grows
        if id(part) in seen or not _can_hold_networks(part):
            continue
        seen.add(id(part))
        if isinstance(part, nn.Module):
            networks.append(part)
            for module in part.modules():
                seen.add(id(module))
                held = vars(module)
                queue += [held[name] for name in held.keys() - MODULE_TABLES]
        else:
            queue += _parts_of(part)
    return networks


def _can_hold_networks(part: object) -> bool:
    if isinstance(part, (type, types.ModuleType, types.BuiltinFunctionType, Tensor)):
        return False
    return callable(part) or isinstance(part, (list, tuple, Mapping))


@functools.singledispatch
def _parts_of(part: object) -> list[Any]:
    """Return the values that a callable or a container may compute with."""
    parts = list(getattr(part, "__dict__", {}).values())
    for kind in type(part).__mro__:
        if "__call__" in vars(kind):
            parts.append(vars(kind)["__call__"])
    return parts


@_parts_of.register(Mapping)
def _(part: Mapping) -> list[Any]:
    return list(part.values()) if len(part) <= MAX_ITEMS else []


@_parts_of.register(list)
@_parts_of.register(tuple)
def _(part: list | tuple) -> list[Any]:
    return list(part) if len(part) <= MAX_ITEMS else []


@_parts_of.register
def _(part: functools.partial) -> list[Any]:
    return [part.func, *part.args, *part.keywords.values()]


@_parts_of.register
def _(part: types.MethodType) -> list[Any]:
    owner = part.__self__
    if isinstance(owner, nn.Module):
        return [owner]
    return [*getattr(owner, "__dict__", {}).values(), part.__func__]


@_parts_of.register
def _(part: types.FunctionType) -> list[Any]:
    values = [*vars(part).values(), *enclosed_values(part), *(part.__defaults__ or ())]
    values += (part.__kwdefaults__ or {}).values()
    for value in named_globals(part).values():
        # functions of libraries compute with no network of the user's
        if not isinstance(value, types.FunctionType) or value.__module__ == part.__module__:
            values.append(value)
    return values


def device_of(model: object) -> torch.device | None:
    """Return the device of a module's weights, or of its buffers; None for any other model."""
    if isinstance(model, nn.Module):
        for value in itertools.chain(model.parameters(), model.buffers()):
            return value.device
    return None
