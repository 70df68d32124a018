"""What identifies a model or a defence in records: whatever its answers may depend on, as far as
it is held as data."""

from __future__ import annotations

import dataclasses
import enum
import functools
import hashlib
import types
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.parameter import is_lazy
from torch.utils.hooks import RemovableHandle

from moireaug.object_graph import enclosed_values, named_globals

OF_MODULES = set(vars(nn.Module()))  # of every module: mode, hooks, and tables of its parts
HOOKS = {"_forward_pre_hooks", "_forward_hooks"}  # of these, what changes a module's answers
PLAIN = ("builtins", "functools", "numpy", "torch")  # packages of values that tell a function
UNKNOWN = "callable "  # before the id in memory of what has no other name


def identity(part: object) -> str:
    """Return what identifies a model or a defence: the weights and settings of a network, the
    settings of any other object, the import path of a function and the values that it names; for a
    lambda or a closure, its id in memory."""
    if isinstance(part, nn.Module):
        return digest(part)
    return " ".join(_told(part, ()))


def digest(model: object) -> str:
    """Return sixteen hex digits that change with a weight, a buffer, or a setting of a layer or of
    anything that it holds. Those of a function change with its import path, its defaults, and the
    values of its module that it names, such as a network. Code is not seen, nor what it loads."""
    sums = hashlib.sha256()
    for told in _told(model, ()):
        sums.update(told.encode() + b"\n")
    return sums.hexdigest()[:16]


def require_identity(name: str, part: object) -> None:
    """Refuse what a later process could not identify.

    Raises:
        ValueError: a lambda, a closure or a function of the script itself, or an object that holds
            one; names it.
    """
    if any(told.startswith(UNKNOWN) for told in _told(part, ())):
        raise ValueError(
            f"records are kept by what was asked, and nothing tells {name}, a "
            f"{type(part).__name__} that is or holds a lambda, a function inside another or one of "
            "the script itself, from others: use functions of an imported module, or leave folder "
            "out."
        )


def _told(part: object, outer: tuple[int, ...]) -> Iterator[str]:
    """Yield what tells a value from others, piece by piece.

    Args:
        outer: ids of the objects that hold it, which it may hold in turn.
    """
    if id(part) in outer:
        yield "itself"
    else:
        yield from _tell(part, (*outer, id(part)))


@functools.singledispatch
def _tell(part: object, outer: tuple[int, ...]) -> Iterator[str]:
    """Yield the settings of an object; what has none is told by its text."""
    if dataclasses.is_dataclass(part) or hasattr(part, "__dict__"):
        yield _path(type(part))
        yield from _told(_settings(part), outer)
    elif callable(part) and not _slots(part):
        yield from _tell_code(part, outer)
    elif " at 0x" in (text := repr(part)):
        yield _path(type(part))
        yield from _told(_slots(part), outer)
    else:
        yield text


@_tell.register
def _tell_module(part: nn.Module, outer: tuple[int, ...]) -> Iterator[str]:
    for name, layer in part.named_modules():
        if hasattr(layer, "_orig_mod"):  # compiled: a later call compiles more
            continue
        yield f"{name} {_path(type(layer))}"
        script = isinstance(layer, torch.jit.ScriptModule)
        yield from _tell_script(layer, outer) if script else _told(_settings(layer), outer)
    values = {**part.state_dict(), **dict(part.named_buffers())}  # some buffers are not saved
    yield from _told(values, outer)


@_tell.register(torch.jit.ScriptModule)
@_tell.register(torch.jit.ScriptFunction)
def _tell_script(part: torch.jit.ScriptModule, outer: tuple[int, ...]) -> Iterator[str]:
    """With its code and constants, among which are a frozen module's weights."""
    yield hashlib.sha256(part.save_to_buffer()).hexdigest()


@_tell.register
def _tell_tensor(part: Tensor, outer: tuple[int, ...]) -> Iterator[str]:
    if is_lazy(part):
        yield "uninitialised"
        return
    yield f"{part.dtype} {part.layout} {tuple(part.shape)}"
    plain = part.detach() if part.layout == torch.strided else part.detach().to_dense()
    plain = plain.resolve_conj().resolve_neg().cpu().contiguous()
    raw = plain.view(-1).view(torch.uint8)  # NumPy has no bfloat16
    yield hashlib.sha256(raw.numpy().data).hexdigest()


@_tell.register
def _tell_array(part: np.ndarray, outer: tuple[int, ...]) -> Iterator[str]:
    yield f"{part.dtype} {part.shape}"
    yield hashlib.sha256(part.tobytes()).hexdigest()


@_tell.register
def _tell_member(part: enum.Enum, outer: tuple[int, ...]) -> Iterator[str]:
    yield str(part)


@_tell.register
def _tell_handle(part: RemovableHandle, outer: tuple[int, ...]) -> Iterator[str]:
    """Without a word on its hook, which is told with the module."""
    yield _path(type(part))


@_tell.register(Mapping)
def _tell_mapping(part: Mapping, outer: tuple[int, ...]) -> Iterator[str]:
    for key in sorted(part, key=repr):
        yield repr(key)
        yield from _told(part[key], outer)


@_tell.register(tuple)
@_tell.register(list)
def _tell_sequence(part: Sequence, outer: tuple[int, ...]) -> Iterator[str]:
    yield "("
    for one in part:
        yield from _told(one, outer)
    yield ")"


@_tell.register(set)
@_tell.register(frozenset)
def _tell_set(part: set | frozenset, outer: tuple[int, ...]) -> Iterator[str]:
    """Without their order, which differs from process to process."""
    yield from sorted(" ".join(_told(one, outer)) for one in part)


@_tell.register
def _tell_partial(part: functools.partial, outer: tuple[int, ...]) -> Iterator[str]:
    yield from _told((part.func, part.args, part.keywords), outer)


@_tell.register
def _tell_method(part: types.MethodType, outer: tuple[int, ...]) -> Iterator[str]:
    yield _path(part.__func__)
    yield from _told(part.__self__, outer)


@_tell.register
def _tell_function(part: types.FunctionType, outer: tuple[int, ...]) -> Iterator[str]:
    """With its defaults, what it encloses, and the values of its module that it names."""
    yield from _tell_code(part, outer)
    yield from _told((part.__defaults__, part.__kwdefaults__), outer)
    for value in enclosed_values(part):
        yield from _told(value, outer)
    for name, value in named_globals(part).items():
        if _is_data(value, part.__module__):
            yield name
            yield from _told(value, outer)


@_tell.register(types.BuiltinFunctionType)
@_tell.register(type)
def _tell_code(part: object, outer: tuple[int, ...]) -> Iterator[str]:
    yield _path(part) if _can_be_imported(part) else f"{UNKNOWN}{id(part)}"


def _is_data(value: object, module: str) -> bool:
    """Return whether a value that a function of `module` names may tell it from another: a network,
    an array, a plain value, an object of its own package, or a function of its own module."""
    if isinstance(value, types.FunctionType):
        return value.__module__ == module
    if isinstance(value, (types.ModuleType, types.BuiltinFunctionType, type)):
        return False
    package = type(value).__module__.split(".")[0]
    return isinstance(value, nn.Module) or package in (*PLAIN, module.split(".")[0])


def _settings(part: object) -> dict[str, object]:
    """Return the attributes that an object holds, without what it computes once and keeps; of a
    module, its hooks are the only ones of those that every module has."""
    found = _slots(part) | getattr(part, "__dict__", {})
    if dataclasses.is_dataclass(part):
        found |= {field.name: getattr(part, field.name) for field in dataclasses.fields(part)}
    for name in list(found):
        if isinstance(getattr(type(part), name, None), functools.cached_property):
            del found[name]
    if isinstance(part, nn.Module):
        for name in OF_MODULES & found.keys():
            value = found.pop(name)
            if name in HOOKS and value:
                found[name] = list(value.values())  # their keys count all hooks of a process
    return found


def _slots(part: object) -> dict[str, object]:
    """Return what an object holds in the slots of its classes."""
    found = {}
    for kind in type(part).__mro__:
        slots = vars(kind).get("__slots__", ())
        for slot in (slots,) if isinstance(slots, str) else slots:
            private = slot.startswith("__") and not slot.endswith("__")
            name = f"_{kind.__name__.lstrip('_')}{slot}" if private else slot
            if name not in ("__dict__", "__weakref__") and hasattr(part, name):
                found[name] = getattr(part, name)
    return found


def _path(part: Any) -> str:
    """Return the module and name of a function or a class."""
    return f"{part.__module__}.{part.__qualname__}"


def _can_be_imported(part: object) -> bool:
    module, name = getattr(part, "__module__", ""), getattr(part, "__qualname__", "")
    return bool(module and name) and "<" not in name and module != "__main__"
