"""The values that a function's code can reach."""

from __future__ import annotations

import types
from typing import Any


def names_in(code: types.CodeType) -> set[str]:
    """Return the names that a function uses, those of the functions inside it included."""
    names = set(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            names |= names_in(constant)
    return names


def enclosed_values(function: types.FunctionType) -> list[Any]:
    """Return the values of a function's closure, without the cells that are still empty."""
    values = []
    for cell in function.__closure__ or ():
        try:
            values.append(cell.cell_contents)
        except ValueError:
            continue
    return values


def named_globals(function: types.FunctionType) -> dict[str, Any]:
    """Return the values of its module that a function names, by name, in a fixed order."""
    names = sorted(names_in(function.__code__) & function.__globals__.keys())
    return {name: function.__globals__[name] for name in names}
