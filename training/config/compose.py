"""What Hydra composes: the settings, the data sets and the recipes; and what --help prints."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf

from training.config.schema import DATA, DEFAULT_DATA, EPOCHS, RECIPES
from training.config.settings import Setting, settings_of, written

PLACES = {"run": {"dir": "."}, "sweep": {"dir": "${runs}", "subdir": "."}, "output_subdir": None}
NO_LOGGING = (
    {"override hydra/job_logging": "none"},
    {"override hydra/hydra_logging": "none"},
)
WITH_DATA = ({"data": DEFAULT_DATA},)
WITH_RECIPE = (*WITH_DATA, {"optional epochs": "${data}"}, {"recipe": "clean"})
HELP_WIDTH = 100  # characters


def register(
    name: str, schema: type, defaults: Sequence[dict[str, str]], about: str | None
) -> None:
    """Register a command with Hydra: its settings, and the data sets and recipes that set them.

    Args:
        name: of the configuration. schema: a dataclass of settings.
        defaults: of the groups of settings. about: what the command does, for --help.
    """
    store = ConfigStore.instance()
    for data, node in DATA.items():
        store.store(group="data", name=data, node=node)
    for data, epochs in EPOCHS.items():
        store.store(group="epochs", name=data, package="train", node={"epochs": epochs})
    for path in recipe_files():
        recipe = OmegaConf.merge({"recipe": path.stem}, OmegaConf.load(path))
        store.store(group="recipe", name=path.stem, package="_global_", node=recipe)
    store.store(name=f"{name}_schema", node=schema)
    # the settings of a command line stand above those of a recipe
    order = [f"{name}_schema", *defaults, "_self_", *NO_LOGGING]
    chosen = {key: value for group in defaults for key, value in group.items()}
    text = help_text(about, schema, chosen).replace("$", "$$")  # of string.Template
    help_page = {"help": {"template": text}}
    store.store(name=name, node={"defaults": order, "hydra": PLACES | help_page})


def recipe_files() -> list[Path]:
    """Return the files of the recipes."""
    return sorted(RECIPES.glob("*.yaml"))


def help_text(about: str | None, schema: type, chosen: Mapping[str, str]) -> str:
    """Return what --help prints: what a command does, and each setting with its default.

    Args:
        chosen: the group of settings that is chosen by default, by its key.
    """
    lines = [inspect.cleandoc(about or ""), "", "Settings:", ""]
    for one in settings_of(schema).values():
        key = one.key.removesuffix(".name")  # a group is chosen by its own name
        lines.append(f"  {key}={chosen.get(key, written(one.default))}")
        if one.facts.help:
            text = f"{one.facts.help}{allowed(one)}"
            indent = " " * 6
            lines += textwrap.wrap(
                text, HELP_WIDTH, initial_indent=indent, subsequent_indent=indent
            )
    return "\n".join(lines)


def allowed(one: Setting) -> str:
    """Return which values a setting may have, as the end of a sentence; "" for any."""
    facts = one.facts
    if facts.choices:
        return f" ({', '.join(facts.choices)})"
    if facts.bounds is None:
        return ""
    low, high = facts.bounds
    return f" (at least {low})" if high is None else f" ({low} to {high})"
