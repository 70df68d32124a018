"""The networks that a model computes with, and their modes."""

from __future__ import annotations

import contextlib
import functools
import inspect
import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from types import FunctionType, MethodType, ModuleType
from typing import Any

import torch
from torch import nn

from moireaug.common.module_state import MODULE_TABLES, ModuleState, restore_states

MAX_COLLECTION_LENGTH = 1000  # of a list or dict; a longer one holds data

# modules that are lent: how many blocks hold each, and the mode and state that the last of them
# restores
_borrowers: weakref.WeakKeyDictionary[nn.Module, int] = weakref.WeakKeyDictionary()
_modes: weakref.WeakKeyDictionary[nn.Module, bool] = weakref.WeakKeyDictionary()
_states: weakref.WeakKeyDictionary[nn.Module, ModuleState] = weakref.WeakKeyDictionary()
_lock = threading.RLock()


@contextlib.contextmanager
def in_evaluation_mode(model: object) -> Iterator[None]:
    """Put the networks of a model into evaluation mode, and each module back into its own mode and
    state on exit, also after an error. Where blocks overlap, in threads or nested, the last one
    does.

    BatchNorm would otherwise update its statistics from images that are not the user's. Modes are
    entered and left through `eval` and `train`, so that a module that does more there than set a
    flag, such as one that merges its low-rank weights, ends as it began. Buffers that forward
    passes write in evaluation mode, too, are put back, see `ModuleState`: observers of a
    quantisation, queues, counters. Weights that they write are not, and warned about; other
    attributes stay as they are.

    Args:
        model: a module, or any callable. The modes that change are those of its networks as
            `networks_of` finds them. Others keep theirs, such as a network in a slot, in a class,
            in an object that cannot be called, in a function that another calls by its name, or one
            that is loaded when the code runs: call its `eval()` yourself. A module that refuses a
            change of mode, as exported graphs do, and a `forward` that changes modes itself cannot
            be protected.
    """
    modules = _parents_first(networks_of(model))
    with _lock:
        for module in modules:
            _modes.setdefault(module, module.training)
            _borrowers[module] = _borrowers.get(module, 0) + 1
    try:
        with _lock:
            _enter_evaluation(modules)
            for module in modules:
                if module not in _states:
                    _states[module] = ModuleState.of(module)
        yield
    finally:
        with _lock:
            _restore(modules)


def _parents_first(networks: Sequence[nn.Module]) -> list[nn.Module]:
    """Return the modules of some networks that have a mode, every parent before its children, also
    where several parents share a child."""
    modules: dict[nn.Module, None] = {}
    for network in networks:
        # the module itself: a proxy of it cannot be hashed
        _add_children_first(next(network.modules()), modules, set())
    # TorchScript's frozen modules have no mode
    return [module for module in reversed(modules) if hasattr(module, "training")]


def _add_children_first(
    module: nn.Module, modules: dict[nn.Module, None], visited: set[nn.Module]
) -> None:
    visited.add(module)
    for child in module.children():
        if child not in visited and child not in modules:
            _add_children_first(child, modules, visited)
    modules.setdefault(module)


def _enter_evaluation(modules: Sequence[nn.Module]) -> None:
    """Put modules, parents first, into evaluation mode; `eval()` of the outermost one in training
    also sets those inside it."""
    in_evaluation: set[nn.Module] = set()
    for module in modules:
        if not module.training or module in in_evaluation:
            continue
        try:
            module.eval()
        except Exception:  # which one depends on the module, such as an exported graph
            module.training = False
            continue
        in_evaluation.update(module.modules())


def _restore(modules: Sequence[nn.Module]) -> None:
    """Release modules, and restore state and mode of each that no other block holds. Parents come
    first, because `train()` of a parent also sets its children, whose own modes are then
    restored."""
    for module in modules:
        _borrowers[module] -= 1
        if not _borrowers[module]:
            del _borrowers[module]
    returned = [module for module in modules if module not in _borrowers]
    try:
        restore_states((module, _states.pop(module)) for module in returned if module in _states)
    finally:
        for module in returned:
            _restore_mode(module)


def _restore_mode(module: nn.Module) -> None:
    """Restore the mode of a module that no block holds."""
    training = _modes.pop(module)
    if module.training == training:
        return
    if not any(inner in _borrowers for inner in module.modules()):
        with contextlib.suppress(Exception):  # of one that refuses
            module.train(training)
    module.training = training  # where its own `train` would keep it in another mode


def networks_of(model: object) -> list[nn.Module]:
    """Return the modules that a model computes with, each once, without their submodules: those
    that `reachable` finds in what can be called, and in lists, tuples and dicts."""
    networks: list[nn.Module] = []
    inner: set[int] = set()
    for part in reachable(model, _can_hold_networks):
        with contextlib.suppress(Exception):  # of proxies, and of mocks, which have no modules
            if isinstance(part, nn.Module) and id(part) not in inner:
                inner.update(map(id, part.modules()))
                networks.append(part)
    return networks


def _can_hold_networks(part: Any) -> bool:
    return callable(part) or isinstance(part, (list, tuple, dict))


def reachable(root: object, is_searched: Callable[[Any], bool]) -> Iterator[Any]:
    """Yield an object and what it leads to, each part once, always in the same order: the
    attributes of an object and the submodules of a module, the entries of lists, tuples and dicts
    of at most 1,000, the object of a bound method, the function and arguments of a partial one,
    and the closure, the defaults and the globals that a function's own code names.

    What a slot, a class, a set or a call holds is not seen, nor what only functions name that a
    function calls, or, before Python 3.12, its comprehensions.

    Args:
        is_searched: function of a part that returns whether to search it, too.
    """
    parts = [root]
    visited: set[int] = set()
    for part in parts:  # which grows
        if id(part) in visited:
            continue
        visited.add(id(part))
        yield part
        with contextlib.suppress(Exception):  # proxies and odd attributes raise anything
            if is_searched(part):
                parts += _parts_of(part)


def _parts_of(owner: Any) -> list[Any]:
    """Return the parts that an object leads to; see `reachable`."""
    if isinstance(owner, (list, tuple, dict)):
        entries = owner.values() if isinstance(owner, dict) else owner
        return [] if len(owner) > MAX_COLLECTION_LENGTH else list(entries)
    if isinstance(owner, functools.partial):
        return [owner.func, *owner.args, *owner.keywords.values()]
    if isinstance(owner, MethodType):
        return [owner.__self__, *_attributes_of(owner.__self__)]
    if isinstance(owner, FunctionType):
        return _variables_of(owner)
    return _attributes_of(owner)


def _variables_of(function: FunctionType) -> list[Any]:
    """Return the closure and the defaults of a function, and its globals but for functions, which
    lead everywhere."""
    variables = inspect.getclosurevars(function)
    values = [*variables.nonlocals.values(), *(function.__defaults__ or ())]
    values += (function.__kwdefaults__ or {}).values()
    return values + [v for v in variables.globals.values() if not isinstance(v, FunctionType)]


def _attributes_of(owner: Any) -> list[Any]:
    """Return an object's attributes; a module's submodules, too, but neither parameters nor
    hooks."""
    if isinstance(owner, (type, ModuleType)):
        return []
    attributes = getattr(owner, "__dict__", {})
    if not isinstance(owner, nn.Module):
        return list(attributes.values())
    others = [attributes[name] for name in attributes if name not in MODULE_TABLES]
    return [*owner.children(), *others]


def device_of(model: object) -> torch.device | None:
    """Return the device of a module's first weight; None where there is none, and for any other
    model.

    Weights are also those of the networks that `networks_of` finds, as in the closure of a function
    that a module calls. A model without weights is where its buffers are, but for those of modules
    that move them to the images, which say so by an attribute `buffers_follow_images = True`.
    """
    networks = networks_of(model) if isinstance(model, nn.Module) else []
    for network in networks:
        for weight in network.parameters():
            return weight.device
    for network in networks:
        for module in network.modules():
            if not getattr(module, "buffers_follow_images", False):
                for buffer in module.buffers(recurse=False):
                    return buffer.device
    return None


def first_weight(*networks: nn.Module) -> torch.Tensor | None:
    """Return the first weight in floating point of some networks; None where they have none."""
    for network in networks:
        for weight in network.parameters():
            if weight.is_floating_point():
                return weight
    return None
