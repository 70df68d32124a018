"""The identity of a run: its group, the settings that its result depends on, and their
fingerprint."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from training.config.data_sets import DEFAULT_DATA
from training.config.schema import Config, RunConfig
from training.config.settings import Facts, settings_of


def group_of(data: Any, model: str) -> str:
    """Return the name of a group of runs that can be compared: "" for default data and model.

    Args:
        data: settings of the data, of which name and root are used.
        model: name of the model.
    """
    name = data.name
    if name == "folder" and data.root:
        folder_name = re.sub(r"[^\w.-]+", "_", Path(data.root).resolve().name)
        name = f"folder-{folder_name}"
    defaults = (DEFAULT_DATA, Config.model)
    return "-".join(part for part in (name, model) if part not in defaults)


def result_settings(cfg: RunConfig) -> dict[str, Any]:
    """Return the settings that a result depends on, as plain values."""
    return _without(asdict(cfg), type(cfg), lambda facts: not facts.changes_result)


def training_settings(cfg: RunConfig) -> dict[str, Any]:
    """Return the settings that the trained weights depend on, as plain values."""
    return training_values(asdict(cfg), type(cfg))


def training_values(values: dict[str, Any], schema: type[RunConfig]) -> dict[str, Any]:
    """Return the values that the trained weights depend on, of all plain values of a schema's
    settings."""
    return _without(values, schema, lambda facts: facts.tests or not facts.changes_result)


def _without(
    values: dict[str, Any], schema: type[RunConfig], is_left_out: Callable[[Facts], bool]
) -> dict[str, Any]:
    for key, declared in settings_of(schema).items():
        *outer, last = key.split(".")
        if is_left_out(declared.facts):
            inner = values[outer[0]] if outer else values
            inner.pop(last, None)
    return values


def fingerprint_of(values: Mapping[str, Any] | list[Any]) -> str:
    """Return twelve hex digits that change with any value."""
    return hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()[:12]
