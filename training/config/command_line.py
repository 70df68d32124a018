"""Command lines in Hydra's grammar: paths quoted and settings checked before Hydra reads them, and
settings written as one."""

import itertools
import os
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from moireaug.common.argument_checks import one_of
from training.config.compose import HELP_WRAPPING, default_config, purpose, recipe_files
from training.config.scenes import SUFFIXES
from training.config.schema import DATA, DEFAULT_DATA, Config, ReattackConfig, RunConfig
from training.config.settings import settings_of, value_of

SWEEP_FLAGS = {"-m", "--multirun"}
CONFIG_FOLDER_FLAGS = {"--config-dir", "-cd"}
# Hydra's flags after which a command prints and ends, and those that take the argument behind them
PRINTING_FLAGS = {"--help", "-h", "--hydra-help", "--version", "--cfg", "-c", "--info", "-i"}
PRINTING_FLAGS |= {"--shell-completion", "-sc"}
VALUED_FLAGS = {"--cfg", "-c", "--info", "-i", "--package", "-p", *CONFIG_FOLDER_FLAGS}
VALUED_FLAGS |= {"--config-path", "-cp", "--config-name", "-cn"}


def quote_paths(overrides: Sequence[str], schema: type[RunConfig]) -> list[str]:
    """Return the overrides with paths that Hydra takes as they are, and `~` in them expanded.

    Hydra's grammar would read 2024_11 as a number and refuse most punctuation. What is quoted or
    escaped for it stays, and so does what a sweep takes for several values."""
    sweep = not SWEEP_FLAGS.isdisjoint(overrides)
    quoted = []
    for override in overrides:
        key, _, value = override.partition("=")
        several = sweep and "," in value
        if _is_path(key, value, schema) and value[0] not in "'\"" and not several:
            override = _quote_path(key, os.path.expanduser(value))
        quoted.append(override)
    return quoted


def _is_path(key: str, value: str, schema: type[RunConfig]) -> bool:
    """Return whether a value is the path of a file or a folder."""
    if value in ("", "null"):
        return False
    if key == "scene":  # or a preset's name, a mapping or a list
        return value.endswith(SUFFIXES)
    if key == "networks":  # or a mapping
        return value[0] != "{"
    table = settings_of(schema)
    return key in table and table[key].is_path


def _quote_path(key: str, path: str) -> str:
    try:
        parsed = OverridesParser.create().parse_override(f"{key}={path}")
        as_it_is = "\\" in path or parsed.value() == path
    except HydraException:
        as_it_is = False
    return f"{key}={path}" if as_it_is else f"{key}={literal(path)}"


def check_keys(overrides: Sequence[str], schema: type[RunConfig]) -> None:
    """Refuse an unknown key, recipe or data set of a command line, with the nearest known one; a
    folder of configurations that is not there; and a line that trains and names no recipe.

    Raises:
        SystemExit: an unknown name; says which are known.
    """
    if schema is Config:
        _require_recipe(overrides)
    try:
        for flag, argument in itertools.pairwise(["", *overrides]):
            name, equals, value = argument.partition("=")
            if name in CONFIG_FOLDER_FLAGS and equals:
                _require_folder(value)
            if flag not in VALUED_FLAGS or equals:
                _check_override(argument, schema)
            elif flag in CONFIG_FOLDER_FLAGS:
                _require_folder(argument)
    except ValueError as error:
        raise SystemExit(f"error: {error}") from None


def _require_recipe(overrides: Sequence[str]) -> None:
    """Refuse a command line without a recipe, unless it only prints, as --help and --cfg do."""
    has_recipe = any(override.lstrip("+").startswith("recipe=") for override in overrides)
    if has_recipe or any(override.partition("=")[0] in PRINTING_FLAGS for override in overrides):
        return
    lines = ["error: say what to train, with one of these recipes:"]
    for path in recipe_files():
        lines += [f"  recipe={path.stem}", textwrap.fill(purpose(path), **HELP_WRAPPING)]
    raise SystemExit("\n".join(lines))


def _require_folder(path: str) -> None:
    """Refuse a folder of configurations that does not exist: Hydra would pass over it."""
    if not Path(path).is_dir():
        raise ValueError(f"--config-dir {path}: there is no such folder.")


def _check_override(override: str, schema: type[RunConfig]) -> None:
    """Refuse an override that is no key=value, of a key that the schema does not have, or with a
    value that the key cannot have."""
    _check_form(override, schema)
    override = override.lstrip("+")
    key, _, value = override.partition("=")
    if key.startswith(("~", "-", "hydra")):
        return
    _check_key(key, schema)
    if key == "data.name":
        raise ValueError(f"{override} keeps the settings of other data: pass data={value}.")
    if key in ("recipe", "data") and issubclass(schema, Config):
        known = DATA if key == "data" else [path.stem for path in recipe_files()]
        for name in value.split(","):
            one_of(key, name, sorted(known))
    else:
        _check_type(override, schema)


def _check_form(override: str, schema: type[RunConfig]) -> None:
    """Refuse an override that is no key=value, and a single value where a list is wanted."""
    key, equals, value = override.partition("=")
    if not equals and not key.startswith(("~", "-")):
        raise ValueError(f"settings are given as key=value; got {override!r}.")
    if equals and not value and not key.startswith("hydra"):
        raise ValueError(f"{override} has no value: leave it out, or pass one, or null for none.")
    declared = settings_of(schema).get(key)
    if declared and declared.is_list and value != "null" and not value.startswith("["):
        raise ValueError(f"{key} must be a list, as in {key}={declared.example}; got {value}.")


def _check_key(key: str, schema: type[RunConfig]) -> None:
    """Refuse a key that the schema does not have."""
    table = settings_of(schema)
    outer = ""
    for part in key.split("."):
        if outer in table:
            if example := table[outer].example:
                raise ValueError(f"{key!r}: pass {outer} whole, as in {outer}={example}.")
            raise ValueError(f"{key!r} is no setting: pass {outer}=VALUE, which has no parts.")
        prefix = f"{outer}." if outer else ""
        inner = [name.removeprefix(prefix) for name in table if name.startswith(prefix)]
        one_of(f"a key in {key!r}", part, dict.fromkeys(name.split(".")[0] for name in inner))
        outer = prefix + part
    if key == "recipe" and schema is ReattackConfig:
        raise ValueError(
            "recipe= says how a model is trained, and this one is only attacked: leave it out."
        )


def _check_type(override: str, schema: type[RunConfig]) -> None:
    """Refuse a value of another type than the schema's; a sweep's are left to Hydra."""
    try:
        parsed = OverridesParser.create().parse_override(override)
        if not parsed.is_sweep_override():
            OmegaConf.update(OmegaConf.structured(schema), parsed.key_or_group, parsed.value())
    except HydraException:
        return  # of its grammar, which Hydra explains by itself
    except OmegaConfBaseException as error:
        key = parsed.key_or_group
        if inner := [name for name in settings_of(schema) if name.startswith(f"{key}.")]:
            raise ValueError(f"{key} has settings of its own: {', '.join(inner)}.") from error
        raise ValueError(f"{key}: {str(error).splitlines()[0]}.") from error


def command_line(cfg: Config) -> list[str]:
    """Return the overrides of fit.py that give these settings."""
    default_cfg = default_config(cfg.recipe, cfg.data.name)
    line = [f"recipe={cfg.recipe}"]
    if cfg.data.name != DEFAULT_DATA:
        line.append(f"data={cfg.data.name}")
    for key in settings_of(Config):
        value = value_of(cfg, key)
        if value != value_of(default_cfg, key):
            line.append(f"{key}={literal(value)}")
    return line


def literal(value: Any) -> str:
    """Return a value in Hydra's grammar."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace("'", "\\'")
        return f"'{escaped}'"
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{k}:{literal(v)}" for k, v in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ",".join(map(literal, value)) + "]"
    return repr(value)
