"""Write docs/settings.md: every setting of every command, as it is declared.

Run it as `python docs/settings.py`, after a setting has changed.
"""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterable
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]


from training import calibrate, frontier, synthesise
from training.config.compose import allowed_values
from training.config.schema import Config, ReattackConfig, RunConfig
from training.config.settings import as_argument, settings_of
from training.demoireing import clean
from training.demoireing.schema import DemoireConfig
from training.detection import fit, score

PAGE = Path(__file__).with_suffix(".md")
INTRODUCTION = """# Settings

Pass `key=value` after a command. Defaults are below, ranges in its `--help`; `null` means unset.
"""
COMMANDS = (
    ("Training classifiers", "training/fit.py", Config),
    ("Attacking trained classifiers", "training/reattack.py", ReattackConfig),
    ("Comparing runs", "training/frontier.py", frontier.Config),
    ("Training demoiréing networks", "training/demoire.py train", DemoireConfig),
    ("Cleaning photos", "training/demoire.py clean", clean.Config),
    ("Training a detector of screen photos", "training/detect.py train", fit.Config),
    ("Scoring photos", "training/detect.py score", score.Config),
    ("Making pairs", "training/synthesise.py", synthesise.Config),
    ("Calibrating a scene", "training/calibrate.py", calibrate.Config),
)


def page() -> str:
    """Return the page."""
    return INTRODUCTION + "\n" + "\n".join(section(*command) for command in COMMANDS)


def section(title: str, command: str, schema: type) -> str:
    """Return the section of a command: a list of its settings, without those that it shares with
    training classifiers."""
    lines = [f"\n## {title}\n\n`python {command}`\n"]
    rows, shared = rows_of(schema), {}
    if issubclass(schema, RunConfig) and schema is not Config:
        shared = dict(rows.items() & rows_of(Config).items())
        names = "" if schema is ReattackConfig else f" named {groups_of(shared, rows)}"
        lines.append(f"Those of training classifiers{names}, and:\n")
    lines += [row for key, row in rows.items() if key not in shared]
    return "\n".join(lines) + "\n"


def rows_of(schema: type) -> dict[str, str]:
    """Return a line for each setting, by key: words alone, as `--help` has the ranges."""
    rows = {}
    for one in settings_of(schema).values():
        key = one.key.removesuffix(".name")  # a group is chosen by its own name
        words = one.help.removeprefix("null: ") if one.default is None else one.help
        words += allowed_values(one) if one.choices else ""
        rows[one.key] = f"- `{key}={as_argument(one.default)}`: {words}"
    return rows


def groups_of(keys: Collection[str], order: Iterable[str]) -> str:
    """Return keys as code, in an order, those of a section as one."""
    groups = {}
    for key in order:
        if key in keys:
            section, dot, _ = key.partition(".")
            groups[f"`{section}.*`" if dot else f"`{key}`"] = True
    return ", ".join(groups)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
