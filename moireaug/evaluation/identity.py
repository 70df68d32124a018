"""The identity of a model or a defence in records: its class, weights and plain settings, or a text
that it states.

An object that holds more than this, such as a function of the user's, has no identity unless it
states one: its records are not reused. Code and files are left out.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import hashlib
import types
import uuid
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.parameter import is_lazy

from moireaug.common.module_state import MODULE_TABLES

NUMBER_TYPES = (int, float, complex, np.generic, torch.dtype)
PLAIN_TYPES = (*NUMBER_TYPES, str, bytes, type(None), slice, range, enum.Enum, torch.device)
LIBRARIES = ("torch", "torchvision", "kornia", "timm", "moireaug")  # their functions hold no data
# of every module: its mode, hooks, and tables of its parts
MODULE_ATTRIBUTES = {*MODULE_TABLES, "_compiled_call_impl"}
ANSWER_HOOKS = ("_forward_pre_hooks", "_forward_hooks")  # hooks that change a module's answers
PROCESS_ID = uuid.uuid4().hex  # of this process alone


class UnidentifiedError(ValueError):
    """An object has no identity; the message names the part that has none."""


def identity_of(value: object, stated: str | bytes | None = None) -> str:
    """Return sixteen hex digits that identify a model or a defence in records. An object without an
    identity gets those of this object in this process.

    Args:
        value: a module, by its class, its `state_dict` and the plain settings of its layers; a
            dataclass, such as a defence, by its class and its fields; or any object with a text in
            its attribute `identity`, which stands for settings and fields.
        stated: the text of an object without that attribute.
    """
    try:
        return _digest(value, stated)
    except UnidentifiedError:
        return _sha256(f"{PROCESS_ID} {id(value)}".encode())[:16]


def plain_or_identity(value: object) -> object:
    """Return a value that JSON holds as it is, and the identity of any other."""
    if value is None or isinstance(value, (str, int, float)):
        return value
    if isinstance(value, (tuple, list)):
        return tuple(map(plain_or_identity, value))
    return identity_of(value)


def require_identity(name: str, value: object) -> None:
    """Refuse a part without an identity, which later calls could not tell from another:
    ValueError."""
    try:
        _digest(value, None)
    except UnidentifiedError as error:
        raise ValueError(
            f"records are kept for later calls, and nothing tells {name}, a "
            f"{type(value).__name__} that is or holds a {error}, from others: only weights and "
            "plain settings do. State a text that you change whenever its answers change, in its "
            "attribute `identity` or, for the model, by evaluate(identity=...); or leave folder "
            "out."
        ) from None


def _digest(value: object, stated: str | bytes | None) -> str:
    try:
        text = _text(value) if stated is None else _stated_text(value, stated)
    except RecursionError:
        raise UnidentifiedError("part that holds itself") from None
    return _sha256(text.encode())[:16]


def _text(value: object) -> str:
    """Return a text that identifies plain data, a dataclass, a module, or a collection of these.

    Raises:
        UnidentifiedError: the value is or holds anything else.
    """
    stated = getattr(value, "identity", None)
    if isinstance(stated, (str, bytes)):
        return _stated_text(value, stated)
    if isinstance(value, PLAIN_TYPES):
        return repr(value)
    for kinds, text_of_kind in TEXTS:
        if isinstance(value, kinds):
            return text_of_kind(value)
    if dataclasses.is_dataclass(value):
        return f"{_import_path(type(value))} {_text(_settings(value))}"
    raise UnidentifiedError(type(value).__name__)


def _stated_text(value: object, stated: str | bytes) -> str:
    weights = _weights(value) if isinstance(value, nn.Module) else {}
    return f"{_import_path(type(value))} {stated!r} {_text(weights)}"


def _module_text(module: nn.Module) -> str:
    lines = [_text(_weights(module))]
    for name, layer in module.named_modules():
        lines.append(f"{name} {_layer_text(layer)}")
    return "\n".join(lines)


def _layer_text(layer: nn.Module) -> str:
    """Return the class and settings of a layer, without those of the layers inside it."""
    if hasattr(layer, "_orig_mod"):  # compiled: that module is a layer of its own
        return ""
    if isinstance(layer, torch.jit.ScriptModule):
        return _script_text(layer)
    return f"{_import_path(type(layer))} {_text(_settings(layer))}"


def _script_text(script: Any) -> str:
    """Return a digest of code and constants, among which are a frozen module's weights."""
    return _sha256(script.save_to_buffer())


def _tensor_text(value: Tensor) -> str:
    if is_lazy(value):
        raise UnidentifiedError("weight that is not there yet")
    plain = value.detach() if value.layout == torch.strided else value.detach().to_dense()
    plain = plain.resolve_conj().resolve_neg().cpu().contiguous()
    raw = plain.view(-1).view(torch.uint8).numpy()  # NumPy has no bfloat16
    return f"{value.dtype} {value.layout} {tuple(value.shape)} {_sha256(raw.data)}"


def _array_text(value: np.ndarray) -> str:
    if value.dtype.hasobject:
        raise UnidentifiedError("array of objects")
    return f"{value.dtype} {value.shape} {_sha256(value.tobytes())}"


def _mapping_text(value: Mapping[object, object]) -> str:
    entries = [f"{_text(key)}: {_text(entry)}" for key, entry in value.items()]
    return f"{{{', '.join(sorted(entries))}}}"


def _function_text(value: Any) -> str:
    package = (value.__module__ or "").partition(".")[0]
    if package not in LIBRARIES or "<" in value.__qualname__:
        raise UnidentifiedError("function")
    return _import_path(value)


def _weights(module: nn.Module) -> dict[str, object]:
    """Return the values of a module's `state_dict`, and the buffers that are not saved."""
    return {**module.state_dict(), **dict(module.named_buffers())}


def _settings(owner: Any) -> dict[str, object]:
    """Return the attributes of a dataclass, or those of a module that not every module has; without
    cached properties, which follow from them.

    Raises:
        UnidentifiedError: a module with hooks that change its answers.
    """
    attributes = dict(getattr(owner, "__dict__", {}))
    if dataclasses.is_dataclass(owner):
        attributes |= {
            field.name: getattr(owner, field.name) for field in dataclasses.fields(owner)
        }
    if isinstance(owner, nn.Module):
        if any(attributes[name] for name in ANSWER_HOOKS):
            raise UnidentifiedError("hook")
        attributes = {name: attributes[name] for name in attributes.keys() - MODULE_ATTRIBUTES}
    settings = {}
    for name, value in attributes.items():
        if not isinstance(getattr(type(owner), name, None), functools.cached_property):
            settings[name] = value
    return settings


def _import_path(value: Any) -> str:
    """Return the module and name of a function or a class."""
    return f"{value.__module__}.{value.__qualname__}"


def _sha256(content: Any) -> str:
    return hashlib.sha256(content).hexdigest()


# how to tell values of each kind apart; the first row that matches applies
TEXTS: tuple[tuple[type | tuple[type, ...], Callable[[Any], str]], ...] = (
    (torch.jit.ScriptFunction, _script_text),
    (nn.Module, _module_text),
    (Tensor, _tensor_text),
    (np.ndarray, _array_text),
    (Mapping, _mapping_text),
    ((list, tuple), lambda value: f"({', '.join(map(_text, value))})"),
    # in a fixed order, as theirs differs from process to process
    ((set, frozenset), lambda value: f"{{{', '.join(sorted(map(_text, value)))}}}"),
    (functools.partial, lambda value: f"partial {_text((value.func, value.args, value.keywords))}"),
    ((types.FunctionType, types.BuiltinFunctionType), _function_text),
    (type, _import_path),
)
