"""The networks that a model computes with, and their modes."""

from __future__ import annotations

import contextlib
import functools
import inspect
import itertools
import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from graphlib import TopologicalSorter
from types import FunctionType, MethodType, ModuleType
from typing import Any

import torch
from torch import nn

from moireaug.common.module_state import MODULE_TABLES, ModuleState, restore_states

MAX_COLLECTION_LENGTH = 1000  # of a list or dict; a longer one holds data


@dataclass
class _Loan:
    """The mode and state that the last of the blocks that hold a module restores."""

    training: bool
    blocks: int = 0
    state: ModuleState | None = None


_loans: weakref.WeakKeyDictionary[nn.Module, _Loan] = weakref.WeakKeyDictionary()
_lock = threading.RLock()


@contextlib.contextmanager
def in_evaluation_mode(model: object) -> Iterator[None]:
    """Put the networks of a model into evaluation mode, and each module back into its own mode and
    state on exit, also after an error. Where blocks overlap, in threads or nested, the last one
    does.

    Modes are entered and left through `eval` and `train`, so that a module that does more there
    than set a flag, such as one that merges its low-rank weights, ends as it began. Buffers that
    forward passes write in evaluation mode, too, are put back, see `ModuleState`: observers of a
    quantisation, queues, counters. Weights that they write are not, and warned about.

    Args:
        model: a module, or any callable. The modes that change are those of its networks as
            `networks_of` finds them: call the `eval()` of others yourself. A module that refuses a
            change of mode, as exported graphs do, and a `forward` that changes modes itself cannot
            be protected.
    """
    modules = _parents_first(networks_of(model))
    with _lock:
        for module in modules:
            _loans.setdefault(module, _Loan(module.training)).blocks += 1
    try:
        with _lock:
            _enter_evaluation(modules)
            for module in modules:
                _loans[module].state = _loans[module].state or ModuleState.of(module)
        yield
    finally:
        with _lock:
            _restore(modules)


def _parents_first(networks: Sequence[nn.Module]) -> list[nn.Module]:
    """Return the modules of networks that have a mode, every parent before its children."""
    parents_first: TopologicalSorter[nn.Module] = TopologicalSorter()
    for network in networks:
        for module in network.modules():
            parents_first.add(module)
            for child in module.children():
                parents_first.add(child, module)
    # TorchScript's frozen modules have no mode
    return [module for module in parents_first.static_order() if hasattr(module, "training")]


def _enter_evaluation(modules: Sequence[nn.Module]) -> None:
    """Put modules, parents first, into evaluation mode; `eval()` also sets those inside."""
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
    """Release modules, and restore state and mode of each that no other block holds: of parents
    first, whose `train()` also sets their children."""
    returned: dict[nn.Module, _Loan] = {}
    for module in modules:
        _loans[module].blocks -= 1
        if not _loans[module].blocks:
            returned[module] = _loans.pop(module)
    try:
        restore_states((module, loan.state) for module, loan in returned.items() if loan.state)
    finally:
        for module, loan in returned.items():
            if module.training == loan.training:
                continue
            if not any(inner in _loans for inner in module.modules()):
                with contextlib.suppress(Exception):  # of one that refuses
                    module.train(loan.training)
            module.training = loan.training  # where its own `train` would keep it in another mode


def networks_of(model: object) -> list[nn.Module]:
    """Return the modules that a model computes with, each once, without their submodules: those
    that `reachable` finds in what can be called, and in lists, tuples and dicts."""
    networks: list[nn.Module] = []
    inner: set[int] = set()
    for part in reachable(model, lambda p: callable(p) or isinstance(p, (list, tuple, dict))):
        with contextlib.suppress(Exception):  # of proxies, and of mocks, which have no modules
            if isinstance(part, nn.Module) and id(part) not in inner:
                inner.update(map(id, part.modules()))
                networks.append(part)
    return networks


def reachable(root: object, is_searched: Callable[[Any], bool]) -> Iterator[Any]:
    """Yield an object and what it leads to, each part once, always in the same order: the
    attributes of an object and the submodules of a module, the entries of lists, tuples and dicts
    of at most 1,000, the object of a bound method, the function and arguments of a partial one,
    and the closure, the defaults and the globals that a function's own code names; not what a slot,
    a class, a set or a call holds, nor what functions name that a function calls.

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
        variables = inspect.getclosurevars(owner)
        values = [*variables.nonlocals.values(), *(owner.__defaults__ or ())]
        values += (owner.__kwdefaults__ or {}).values()
        # functions lead everywhere
        return values + [v for v in variables.globals.values() if not isinstance(v, FunctionType)]
    return _attributes_of(owner)


def _attributes_of(owner: Any) -> list[Any]:
    """Return an object's attributes; of a module its submodules, too, but no parameters, hooks."""
    if isinstance(owner, (type, ModuleType)):
        return []
    attributes = getattr(owner, "__dict__", {})
    if not isinstance(owner, nn.Module):
        return list(attributes.values())
    others = [attributes[name] for name in attributes if name not in MODULE_TABLES]
    return [*owner.children(), *others]


def rejects_of(model: object) -> bool:
    """Return whether the last logit of a model is that of rejecting the image, which it says by an
    attribute `rejects`; see `defenses.Rejecting`.

    Raises:
        ValueError: a network inside says that it rejects, and the model does not say whether.
    """
    rejects = getattr(model, "rejects", None)
    if rejects is not None:
        return bool(rejects)
    for network in networks_of(model):
        for module in network.modules():
            if getattr(module, "rejects", False):
                raise ValueError(
                    f"a {type(module).__name__} inside the model rejects images, and the model, a "
                    f"{type(model).__name__}, does not say so: its last logit would count as a "
                    "class. Put the Rejecting outermost, or set the model's attribute rejects = "
                    "True; or False, if it leaves that logit out."
                )
    return False


def is_randomised(part: object) -> bool:
    """Return whether a model or defence draws random numbers, which it, or a network inside it,
    says by an attribute `randomised`."""
    randomised = getattr(part, "randomised", None)
    if randomised is not None:
        return bool(randomised)
    modules = itertools.chain.from_iterable(network.modules() for network in networks_of(part))
    return any(getattr(module, "randomised", False) for module in modules)


def device_of(model: object) -> torch.device | None:
    """Return the device of the first weight of a module, and of the networks that `networks_of`
    finds in it, or else of a buffer, but for those of modules that move them to the images, which
    say so by an attribute `buffers_follow_images = True`; None of any other model."""
    networks = networks_of(model) if isinstance(model, nn.Module) else []
    tensors: list[torch.Tensor] = [w for network in networks for w in network.parameters()]
    for network in networks:
        for module in network.modules():
            if not getattr(module, "buffers_follow_images", False):
                tensors += module.buffers(recurse=False)
    return tensors[0].device if tensors else None


def first_weight(*networks: nn.Module) -> torch.Tensor | None:
    """Return the first weight in floating point of some networks; None where they have none."""
    for network in networks:
        for weight in network.parameters():
            if weight.is_floating_point():
                return weight
    return None
