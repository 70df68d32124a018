"""Formulas over the operations of a library."""

from __future__ import annotations

import builtins
import importlib
from collections.abc import Callable
from types import FunctionType, ModuleType
from typing import Any


def bind(
    subject: str,
    operations: dict[str, Any],
    compiled: Callable[[FunctionType], Any] = lambda function: function,
    constant: Callable[[float], Any] = float,
) -> Any:
    """Return a module of formulas over a library's operations, to be called from what the library
    compiles, too.

    Args:
        subject: name of a module of this package.
        operations: by their names in `operations`, or in the module.
        compiled: makes of a function what the library calls. constant: makes of a number what its
            functions read.
    """
    formulas = importlib.import_module(f"moireaug.common.physics.{subject}")
    own = {
        name: value
        for name, value in vars(formulas).items()
        if isinstance(value, FunctionType) and value.__module__ == formulas.__name__
    }
    # without a name, which torch.compile would take for that of the module
    names = {name: value for name, value in vars(formulas).items() if not name.startswith("__")}
    for name, value in names.items():
        if isinstance(value, (int, float)):
            names[name] = constant(value)
    names |= operations | {"__builtins__": builtins}
    for name, function in own.items():
        copy = FunctionType(function.__code__, names, name)
        copy.__module__, copy.__doc__ = formulas.__name__, function.__doc__
        names[name] = compiled(copy)
    module = ModuleType(formulas.__name__)
    for name in own:
        setattr(module, name, names[name])
    return module
