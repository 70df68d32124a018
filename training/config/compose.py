"""The configurations that Hydra composes, of settings, data sets and recipes; and the text of
--help."""

import contextlib
import inspect
import re
import textwrap
from collections.abc import Mapping, Sequence

from hydra.core.config_store import ConfigStore

from training.config.command_line import HELP_WRAPPING
from training.config.data_sets import DATA, DATA_SETS, DEFAULT_DATA
from training.config.recipes import read_recipe, recipe_files
from training.config.settings import Setting, as_argument, settings_of

HYDRA_FOLDERS = {
    "run": {"dir": "."},
    "sweep": {"dir": "${runs}", "subdir": "."},
    "output_subdir": None,
}
NO_LOGGING = ({"override hydra/job_logging": "none"}, {"override hydra/hydra_logging": "none"})
DATA_GROUPS = ({"data": DEFAULT_DATA},)
RECIPE_GROUPS = (*DATA_GROUPS, {"optional epochs_of_data": "${data}"}, {"recipe": "clean"})
MIN_FAR_BOUND = 10_000  # a bound that only a mistake exceeds
HELP_TEXTS: dict[type, str] = {}  # of the registered commands, by their settings


def register(
    name: str, schema: type, defaults: Sequence[dict[str, str]], description: str | None
) -> None:
    """Register a command with Hydra: its settings, and the data sets and recipes that set them.

    Args:
        defaults: default choice of each group of settings.
    """
    store = ConfigStore.instance()
    for data, node in DATA.items():
        store.store(group="data", name=data, node=node)
    for data, one in DATA_SETS.items():
        if one.epochs:
            store.store(
                group="epochs_of_data", name=data, package="train", node={"epochs": one.epochs}
            )
    default_groups = {key: value for group in defaults for key, value in group.items()}
    if "recipe" in default_groups:
        default_groups["recipe"] = "NAME"  # a command line names its own
        for path in recipe_files():
            with contextlib.suppress(ValueError):  # `require_recipe` says why, where it is chosen
                recipe = read_recipe(path)
                store.store(group="recipe", name=path.stem, package="_global_", node=recipe)
    store.store(name=f"{name}_schema", node=schema)
    # the settings of a command line stand above those of a recipe
    order = [f"{name}_schema", *defaults, "_self_", *NO_LOGGING]
    store.store(name=name, node={"defaults": order, "hydra": HYDRA_FOLDERS})
    HELP_TEXTS[schema] = help_text(description, schema, default_groups)


def help_text(description: str | None, schema: type, default_groups: Mapping[str, str]) -> str:
    """Return the text of --help: the command's description, and each setting with its default."""
    lines = [inspect.cleandoc(description or ""), "", "Settings:", ""]
    for one in settings_of(schema).values():
        key = one.key.removesuffix(".name")  # a group is chosen by its own name
        lines.append(f"  {key}={default_groups.get(key, as_argument(one.default))}")
        if one.help:
            lines += textwrap.wrap(f"{one.help}{allowed_values(one)}", **HELP_WRAPPING)
    return "\n".join(lines)


def allowed_values(one: Setting) -> str:
    """Return which values a setting may have, as the end of a sentence; "" for any, for words that
    its help names, and where only a mistake is out of bounds."""
    if not set(one.choices) <= set(re.findall(r"[\w-]+", one.help)):
        return f" ({', '.join(one.choices)})"
    if one.bounds is None:
        return ""
    low, high = one.bounds
    if high is None or high >= MIN_FAR_BOUND:
        return f" (at least {low})" if low > 1 else ""
    return f" ({low} to {high})"
