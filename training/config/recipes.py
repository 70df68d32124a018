"""The recipes: the files of recipes/, each a YAML mapping of the settings that differ."""

import itertools
import re
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from training.config.command_line import HELP_WRAPPING, PRINTING_FLAGS, reason_of
from training.config.schema import RECIPES, Config, Train

PLAIN_RECIPES = ("clean", "baseline")  # without an adversary: the others are compared with them
RECIPE_NAME = re.compile(r"\w[\w.-]*")  # which is also a folder's


def recipe_files() -> list[Path]:
    """Return the files of the recipes; hidden ones are an editor's."""
    return sorted(path for path in RECIPES.glob("*.yaml") if not path.name.startswith("."))


def purpose(recipe: Path) -> str:
    """Return what a recipe is for: the first sentence of the comment that its file begins with."""
    lines = recipe.read_text("utf-8", "replace").splitlines()
    comment = itertools.takewhile(lambda line: line.startswith("#"), lines)
    return " ".join(line.removeprefix("#").strip() for line in comment).split(". ")[0].rstrip(".")


def read_recipe(path: Path) -> dict[str, Any]:
    """Return the settings of a recipe, and its name."""
    if not RECIPE_NAME.fullmatch(path.stem):
        raise ValueError(
            f"{path} cannot be the name of a recipe: rename it, with letters, digits, _, . and -."
        )
    try:
        values = OmegaConf.load(path)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{path} could not be read as YAML: {reason}.") from error
    if not isinstance(values, DictConfig):
        raise ValueError(f"{path} is no recipe: it must be a YAML mapping of settings.")
    if "recipe" in values:
        raise ValueError(f"{path} sets recipe=, which is the name of the file: leave it out.")
    settings: dict[str, Any] = OmegaConf.to_container(values)  # type: ignore[assignment]
    others = [str(key) for key in settings if key != "train"]
    if path.stem in PLAIN_RECIPES and others:
        raise ValueError(
            f"{path} sets {', '.join(others)}, and a recipe that the others are compared with sets "
            "train alone: leave the rest out, or put it into a recipe of another name."
        )
    return {"recipe": path.stem, **settings}


def check_recipe(path: Path) -> None:
    """Refuse a recipe that cannot be read, or has settings that there are not."""
    cfg = OmegaConf.structured(Config)
    try:
        for key, value in read_recipe(path).items():
            OmegaConf.update(cfg, key, value)
    except OmegaConfBaseException as error:
        raise ValueError(f"{path}: {reason_of(error, Config)}") from error


def plain_training(recipe: str, train: Train) -> Train:
    """Return how a recipe of `PLAIN_RECIPES` trains, with the settings of another training that its
    file does not state; init and length are a recipe's own."""
    path = RECIPES / f"{recipe}.yaml"
    check_recipe(path)
    own = {"init": Train.init, "length": Train.length, **read_recipe(path).get("train", {})}
    plain: Train = OmegaConf.to_object(  # type: ignore[assignment]
        OmegaConf.merge(OmegaConf.structured(train), own)
    )
    return plain


def require_recipe(overrides: Sequence[str]) -> None:
    """Refuse a command line without a recipe, unless it only prints, as --help and --cfg do, and
    one with a recipe that cannot be used.

    Raises:
        SystemExit: no recipe, and lists what each is for; or why one cannot be used.
    """
    keys_and_values = [override.lstrip("+").partition("=") for override in overrides]
    chosen = [value for key, _, value in keys_and_values if key == "recipe"]
    for path in recipe_files():
        if path.stem in ",".join(chosen).split(","):
            try:
                check_recipe(path)
            except ValueError as error:
                raise SystemExit(f"error: {error}") from None
    if chosen or any(key in PRINTING_FLAGS for key, _, _ in keys_and_values):
        return
    lines = ["error: say what to train, with one of these recipes:"]
    for path in recipe_files():
        lines += [f"  recipe={path.stem}", textwrap.fill(purpose(path), **HELP_WRAPPING)]
    raise SystemExit("\n".join(lines))
