"""Command lines in Hydra's grammar: paths quoted before Hydra reads them, and what it refuses in
words."""

import os
from collections.abc import Sequence
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException

from moireaug.common.argument_checks import one_of
from training.config.scenes import SUFFIXES
from training.config.schema import RunConfig
from training.config.settings import settings_of

SWEEP_FLAGS = {"-m", "--multirun"}
# flags after which a command prints and ends
HELP_FLAGS = {"--help", "-h"}
PRINTING_FLAGS = HELP_FLAGS | {"--hydra-help", "--version", "--cfg", "-c", "--info", "-i"}
# of a line of help
HELP_WRAPPING: Any = {"width": 100, "initial_indent": " " * 6, "subsequent_indent": " " * 6}


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
    escaped = path.replace("\\", "\\\\").replace("'", "\\'")
    return f"{key}={path}" if as_it_is else f"{key}='{escaped}'"


def why_refused(error: HydraException, schema: type[RunConfig]) -> str:
    """Return the reason why Hydra refused a command line, and what it takes instead."""
    cause = error.__cause__
    if not isinstance(cause, OmegaConfBaseException) or not cause.full_key:
        return str(error).partition("\nConfig search path")[0]
    return reason_of(cause, schema)


def reason_of(error: OmegaConfBaseException, schema: type[RunConfig]) -> str:
    """Return the reason why a key or a value was refused, and what is taken instead."""
    table = settings_of(schema)
    key = (error.full_key or "").partition("[")[0]
    outer, _, name = key.rpartition(".")
    if isinstance(error, (AttributeError, KeyError)) and outer not in table:
        prefix = f"{outer}." if outer else ""
        known = [one.removeprefix(prefix) for one in table if one.startswith(prefix)]
        try:
            one_of(f"a key in {key!r}", name, dict.fromkeys(one.split(".")[0] for one in known))
        except ValueError as unknown:
            return str(unknown)
    reason = f"{key}: {str(error).splitlines()[0].rstrip('.')}."
    if inner := [one for one in table if one.startswith(f"{key}.")]:
        return f"{reason} Its settings: {', '.join(inner)}."
    for one in (key, outer):
        if one in table and table[one].example:
            return f"{reason} Pass {one} whole, as in {one}={table[one].example}."
    return reason
