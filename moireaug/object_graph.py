"""The graph of an object: the parts that it holds, and those of the functions that it calls."""

from __future__ import annotations

import contextlib
import functools
import sys
import sysconfig
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import (
    CodeType,
    FunctionType,
    MappingProxyType,
    MemberDescriptorType,
    MethodType,
    ModuleType,
)
from typing import Any

from torch import nn

MAX_COLLECTION_LENGTH = 1000  # of a list or dict; a longer one holds data
MAX_PARTS = 50_000  # that a search looks at
MODULE_TABLES = frozenset(vars(nn.Module()))  # of every nn.Module: its mode, hooks and parts
OWN_PACKAGE = __name__.partition(".")[0]


def walk(root: Any, is_searched: Callable[[Any], bool]) -> Iterator[Any]:
    """Yield an object and whatever it leads to, each part once, always in the same order.

    Args:
        is_searched: function of a part that returns whether to search it, too.
    """
    queue = [root]
    visited: set[int] = set()
    for part in queue:  # which grows
        if id(part) in visited:
            continue
        if len(visited) == MAX_PARTS:
            return
        visited.add(id(part))
        yield part
        with contextlib.suppress(Exception):  # proxies and odd attributes raise anything
            if is_searched(part):
                queue += parts_of(part)


def parts_of(owner: Any) -> list[Any]:
    """Return the parts that an object, a collection, a class or a function holds."""
    parts: list[Any] = []
    for kinds, parts_of_kind in PARTS_OF_KINDS:
        if isinstance(owner, kinds):
            parts += parts_of_kind(owner)
    return parts


def names_in(code: CodeType) -> set[str]:
    """Return the names that a function uses, those of the functions inside it included."""
    names = set(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            names |= names_in(constant)
    return names


def enclosed_values(function: FunctionType) -> list[Any]:
    """Return the values of a function's closure, without the cells that are still empty."""
    values = []
    for cell in function.__closure__ or ():
        with contextlib.suppress(ValueError):
            values.append(cell.cell_contents)
    return values


def _entries_of(collection: Any) -> Iterable[Any]:
    if len(collection) > MAX_COLLECTION_LENGTH:
        return ()
    return collection.values() if isinstance(collection, Mapping) else collection


def _function_parts_of(function: FunctionType) -> list[Any]:
    defaults = [*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()]
    return [*defaults, *enclosed_values(function), *_globals_of(function)]


def _globals_of(function: FunctionType) -> list[Any]:
    """Return the globals that a function's code names, in its own module and in the modules that it
    names, without those of libraries."""
    names = names_in(function.__code__)
    namespaces, values = [function.__globals__], []
    for namespace in namespaces:  # which grows
        if _is_of_library(namespace):
            continue
        for name in sorted(names & namespace.keys()):
            value = namespace[name]
            if not isinstance(value, ModuleType):
                values.append(value)
            elif all(vars(value) is not known for known in namespaces):
                namespaces.append(vars(value))
    return values


def _class_parts_of(kind: type) -> list[Any]:
    """Return the attributes and methods of a class, and its bases; nothing for a library's."""
    module = sys.modules.get(kind.__module__)
    if module is not None and _is_of_library(vars(module)):
        return []
    return [*vars(kind).values(), *kind.__bases__]


def _attributes_of(owner: Any) -> list[Any]:
    """Return an object's attributes, its slots among them, and its class; of an nn.Module, its
    submodules and what it holds besides, but neither parameters nor hooks."""
    if isinstance(owner, (type, ModuleType)):
        return []
    attributes = getattr(owner, "__dict__", {})
    parts = list(attributes.values())
    if isinstance(owner, nn.Module):
        parts = [attributes[name] for name in attributes if name not in MODULE_TABLES]
        parts += owner.children()
    for kind in type(owner).__mro__:
        if "__slots__" not in vars(kind):
            continue
        for slot in vars(kind).values():
            if isinstance(slot, MemberDescriptorType):
                with contextlib.suppress(AttributeError):  # a slot that is still empty
                    parts.append(slot.__get__(owner))
    return [*parts, type(owner)]


def _is_of_library(namespace: dict[str, Any]) -> bool:
    """Return whether a module's globals belong to Python, this package or an installed one: they
    hold nothing of the user's, and lead everywhere."""
    return _is_in_library(str(namespace.get("__name__")), namespace.get("__file__"))


@functools.cache
def _is_in_library(name: str, file: str | None) -> bool:
    if name.partition(".")[0] == OWN_PACKAGE or name in sys.builtin_module_names:
        return True
    if not file:  # a notebook
        return False
    path = Path(file)
    installed = {"site-packages", "dist-packages"} & {*path.parts}
    return bool(installed) or path.is_relative_to(sysconfig.get_path("stdlib"))


# how to list the parts of each kind of object; every row that matches applies
PARTS_OF_KINDS: tuple[tuple[type | tuple[type, ...], Callable[[Any], Iterable[Any]]], ...] = (
    ((list, tuple, deque, dict, MappingProxyType), _entries_of),
    (functools.partial, lambda call: (call.func, call.args, call.keywords)),
    (MethodType, lambda method: (method.__self__, method.__func__)),
    (MethodType, lambda method: _attributes_of(method.__self__)),
    ((staticmethod, classmethod), lambda method: (method.__func__,)),
    (property, lambda method: (method.fget,)),
    (FunctionType, _function_parts_of),
    (type, _class_parts_of),
    (object, _attributes_of),
)
