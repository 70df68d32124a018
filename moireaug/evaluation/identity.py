"""The identity of a model or a defence in records: a digest of all data that its answers may depend
on."""

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

MODULE_ATTRIBUTES = set(vars(nn.Module()))  # of every module: mode, hooks, and tables of its parts
ANSWER_HOOKS = {"_forward_pre_hooks", "_forward_hooks"}  # hooks that change a module's answers
DATA_PACKAGES = ("builtins", "functools", "numpy", "torch")  # whose values identify a function
UNNAMED_PREFIX = "callable "  # before the id in memory of an object that cannot be imported


def identity(value: object) -> str:
    """Return the text that identifies a model or a defence: a network's weights and settings, the
    settings of any other object, the import path of a function and the values that it names; for a
    lambda or a closure, its id in memory."""
    if isinstance(value, nn.Module):
        return digest(value)
    return " ".join(_digest_parts(value, ()))


def digest(model: object) -> str:
    """Return sixteen hex digits that change with a weight, a buffer, or a setting of a layer or of
    anything that it holds. Those of a function change with its import path, its defaults, and the
    values of its module that it names, such as a network. Code and files are left out."""
    sha256 = hashlib.sha256()
    for part in _digest_parts(model, ()):
        sha256.update(part.encode() + b"\n")
    return sha256.hexdigest()[:16]


def require_identity(name: str, value: object) -> None:
    """Refuse a part that a later process could not identify: a lambda, a closure or a function of
    the script itself, or an object that holds one: ValueError."""
    if any(part.startswith(UNNAMED_PREFIX) for part in _digest_parts(value, ())):
        raise ValueError(
            f"records are kept by what was asked, and nothing tells {name}, a "
            f"{type(value).__name__} that is or holds a lambda, a function inside another or one "
            "of the script itself, from others: use functions of an imported module, or leave "
            "folder out."
        )


def _digest_parts(value: object, holders: tuple[int, ...]) -> Iterator[str]:
    """Yield the texts that the digest of a value is made of.

    Args:
        holders: ids of the objects that hold the value, and that it may hold in turn.
    """
    if id(value) in holders:
        yield "itself"
    else:
        yield from _parts_of(value, (*holders, id(value)))


@functools.singledispatch
def _parts_of(value: object, holders: tuple[int, ...]) -> Iterator[str]:
    """Yield the settings of an object, or its text where it has none."""
    if dataclasses.is_dataclass(value) or hasattr(value, "__dict__"):
        yield _import_path(type(value))
        yield from _digest_parts(_settings(value), holders)
    elif callable(value) and not _slot_values(value):
        yield from _parts_of_code(value, holders)
    elif " at 0x" in (text := repr(value)):
        yield _import_path(type(value))
        yield from _digest_parts(_slot_values(value), holders)
    else:
        yield text


@_parts_of.register
def _parts_of_module(value: nn.Module, holders: tuple[int, ...]) -> Iterator[str]:
    for name, layer in value.named_modules():
        if hasattr(layer, "_orig_mod"):  # compiled: a later call compiles more
            continue
        yield f"{name} {_import_path(type(layer))}"
        if isinstance(layer, torch.jit.ScriptModule):
            yield from _parts_of_script(layer, holders)
        else:
            yield from _digest_parts(_settings(layer), holders)
    values = {**value.state_dict(), **dict(value.named_buffers())}  # some buffers are not saved
    yield from _digest_parts(values, holders)


@_parts_of.register(torch.jit.ScriptModule)
@_parts_of.register(torch.jit.ScriptFunction)
def _parts_of_script(value: torch.jit.ScriptModule, holders: tuple[int, ...]) -> Iterator[str]:
    """Yield a digest of code and constants, among which are a frozen module's weights."""
    yield hashlib.sha256(value.save_to_buffer()).hexdigest()


@_parts_of.register
def _parts_of_tensor(value: Tensor, holders: tuple[int, ...]) -> Iterator[str]:
    if is_lazy(value):
        yield "uninitialised"
        return
    yield f"{value.dtype} {value.layout} {tuple(value.shape)}"
    plain = value.detach() if value.layout == torch.strided else value.detach().to_dense()
    plain = plain.resolve_conj().resolve_neg().cpu().contiguous()
    raw = plain.view(-1).view(torch.uint8)  # NumPy has no bfloat16
    yield hashlib.sha256(raw.numpy().data).hexdigest()


@_parts_of.register
def _parts_of_array(value: np.ndarray, holders: tuple[int, ...]) -> Iterator[str]:
    yield f"{value.dtype} {value.shape}"
    yield hashlib.sha256(value.tobytes()).hexdigest()


@_parts_of.register
def _parts_of_enum(value: enum.Enum, holders: tuple[int, ...]) -> Iterator[str]:
    yield str(value)


@_parts_of.register
def _parts_of_hook_handle(value: RemovableHandle, holders: tuple[int, ...]) -> Iterator[str]:
    """Yield the type alone: the hook itself belongs to its module."""
    yield _import_path(type(value))


@_parts_of.register(Mapping)
def _parts_of_mapping(value: Mapping, holders: tuple[int, ...]) -> Iterator[str]:
    for key in sorted(value, key=repr):
        yield repr(key)
        yield from _digest_parts(value[key], holders)


@_parts_of.register(tuple)
@_parts_of.register(list)
def _parts_of_sequence(value: Sequence, holders: tuple[int, ...]) -> Iterator[str]:
    yield "("
    for one in value:
        yield from _digest_parts(one, holders)
    yield ")"


@_parts_of.register(set)
@_parts_of.register(frozenset)
def _parts_of_set(value: set | frozenset, holders: tuple[int, ...]) -> Iterator[str]:
    """Yield the members in a fixed order, as theirs differs from process to process."""
    yield from sorted(" ".join(_digest_parts(one, holders)) for one in value)


@_parts_of.register
def _parts_of_partial(value: functools.partial, holders: tuple[int, ...]) -> Iterator[str]:
    yield from _digest_parts((value.func, value.args, value.keywords), holders)


@_parts_of.register
def _parts_of_method(value: types.MethodType, holders: tuple[int, ...]) -> Iterator[str]:
    yield _import_path(value.__func__)
    yield from _digest_parts(value.__self__, holders)


@_parts_of.register
def _parts_of_function(function: types.FunctionType, holders: tuple[int, ...]) -> Iterator[str]:
    """Yield the import path, the defaults, and the values that the function encloses or names in
    its module."""
    yield from _parts_of_code(function, holders)
    yield from _digest_parts((function.__defaults__, function.__kwdefaults__), holders)
    for value in enclosed_values(function):
        yield from _digest_parts(value, holders)
    for name, value in named_globals(function).items():
        if _is_data(value, function.__module__):
            yield name
            yield from _digest_parts(value, holders)


@_parts_of.register(types.BuiltinFunctionType)
@_parts_of.register(type)
def _parts_of_code(value: object, holders: tuple[int, ...]) -> Iterator[str]:
    yield _import_path(value) if _can_be_imported(value) else f"{UNNAMED_PREFIX}{id(value)}"


def _is_data(value: object, module: str) -> bool:
    """Return whether a value that a function of `module` names identifies the function: a network,
    an array, a plain value, an object of its own package, or a function of its own module."""
    if isinstance(value, types.FunctionType):
        return value.__module__ == module
    if isinstance(value, (types.ModuleType, types.BuiltinFunctionType, type)):
        return False
    package = type(value).__module__.split(".")[0]
    return isinstance(value, nn.Module) or package in (*DATA_PACKAGES, module.split(".")[0])


def _settings(owner: object) -> dict[str, object]:
    """Return the attributes of an object without its cached properties; of the attributes that
    every module has, its hooks alone."""
    settings = _slot_values(owner) | getattr(owner, "__dict__", {})
    if dataclasses.is_dataclass(owner):
        settings |= {field.name: getattr(owner, field.name) for field in dataclasses.fields(owner)}
    for name in list(settings):
        if isinstance(getattr(type(owner), name, None), functools.cached_property):
            del settings[name]
    if isinstance(owner, nn.Module):
        for name in MODULE_ATTRIBUTES & settings.keys():
            value = settings.pop(name)
            if name in ANSWER_HOOKS and value:
                settings[name] = list(value.values())  # their keys count all hooks of a process
    return settings


def _slot_values(value: object) -> dict[str, object]:
    """Return the values in the slots of an object's classes, by name."""
    values = {}
    for kind in type(value).__mro__:
        slots = vars(kind).get("__slots__", ())
        for slot in (slots,) if isinstance(slots, str) else slots:
            private = slot.startswith("__") and not slot.endswith("__")
            name = f"_{kind.__name__.lstrip('_')}{slot}" if private else slot
            if name not in ("__dict__", "__weakref__") and hasattr(value, name):
                values[name] = getattr(value, name)
    return values


def _import_path(value: Any) -> str:
    """Return the module and name of a function or a class."""
    return f"{value.__module__}.{value.__qualname__}"


def _can_be_imported(value: object) -> bool:
    module, name = getattr(value, "__module__", ""), getattr(value, "__qualname__", "")
    return bool(module and name) and "<" not in name and module != "__main__"
