"""The identity of a run: its group, the settings that its result depends on, their fingerprint, and
the data and weights that it began with."""

import copy
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from omegaconf import OmegaConf

from training.config.data_sets import DEFAULT_DATA, is_published, is_users_own
from training.config.schema import Config, RunConfig
from training.config.settings import settings_of
from training.system.files import digest


@dataclass(frozen=True)
class Origin:
    """The data and the first weights of a training, as its checkpoints hold them.

    Args:
        files: fingerprint of the files that train and validate; empty where the settings determine
            the data, None where it is not known yet.
        classes: name of each logit of a classifier.
        weights: digest of the file of `weights=`; empty where there is none.
    """

    files: str | None = None
    classes: Mapping[int, str] = field(default_factory=dict)
    weights: str = ""

    @classmethod
    def of(cls, weights: str | None, data: Any = None) -> Self:
        """Return the origin of a training with this `weights=`.

        Args:
            data: its data, which know their `files` and `classes`; None until they are loaded.
        """
        has_file = weights is not None and Path(weights).is_file()  # not published by a name
        weights_digest = digest(str(weights)) if has_file else ""
        if data is None:
            return cls(weights=weights_digest)
        return cls(data.files, data.classes, weights_digest)


def group_of(data: Any, model: str) -> str:
    """Return the name of a group of runs that can be compared: "" for default data and model."""
    name = data.name
    if is_users_own(name) and data.root:
        folder_name = re.sub(r"[^\w.-]+", "_", Path(data.root).resolve().name)
        name = f"{name}-{folder_name}"
    defaults = (DEFAULT_DATA, Config.model)
    return "-".join(part for part in (name, model) if part not in defaults)


def result_settings(values: Mapping[str, Any], schema: type[RunConfig]) -> dict[str, Any]:
    """Return the settings that a result depends on, as plain values, of plain values of a schema's
    settings; a setting that they lack, as it is newer, has its default."""
    merged = OmegaConf.merge(OmegaConf.structured(schema), values)
    settings: dict[str, Any] = OmegaConf.to_container(merged)  # type: ignore[assignment]
    for key, setting in settings_of(schema).items():
        if not setting.changes_result:
            _leave_out(key, settings)
    return settings


def result_fingerprint(settings: Mapping[str, Any]) -> str:
    """Return the fingerprint of the settings that a result depends on; the place of a published
    data set is none of them."""
    decisive = copy.deepcopy(dict(settings))
    if is_published(decisive["data"].get("name")):
        _leave_out("data.root", decisive)
    return fingerprint_of(decisive)


def training_fingerprint(settings: Mapping[str, Any], schema: type[RunConfig]) -> str:
    """Return the fingerprint of the settings that the trained weights depend on, of those that a
    result depends on. Training on clean images alone does not depend on the scene."""
    decisive = copy.deepcopy(dict(settings))
    for key, setting in settings_of(schema).items():
        if setting.tests:
            _leave_out(key, decisive)
    adversary = decisive.get("adversary")
    if adversary and adversary["kind"] == "none" and not adversary["natural"]:
        _leave_out("scene", decisive)
        _leave_out("shrink", decisive)
    return result_fingerprint(decisive)


def _leave_out(key: str, values: dict[str, Any]) -> None:
    section, _, name = key.rpartition(".")
    (values[section] if section else values).pop(name, None)


def fingerprint_of(values: Mapping[str, Any] | list[Any]) -> str:
    """Return twelve hex digits that change with any value."""
    return hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()[:12]
