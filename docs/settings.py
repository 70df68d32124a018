"""Write docs/settings.md: every setting of every command, as it is declared.

Run it as `python docs/settings.py`, after a setting has changed.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]


from training import calibrate, explore, frontier, synthesise
from training.config.compose import allowed_values
from training.config.schema import Config, ReattackConfig
from training.config.settings import Setting, as_argument, settings_of
from training.demoireing import clean
from training.demoireing.schema import DemoireConfig
from training.detection import fit, score

PAGE = Path(__file__).with_suffix(".md")
INTRODUCTION = """# Settings

Pass `key=value` after a command; its `--help` also prints the ranges. `null` is no value.
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
    ("Explorer", "training/explore.py", explore.Config),
)


def page() -> str:
    """Return the page."""
    return INTRODUCTION.rstrip() + "\n\n" + "\n".join(section(*command) for command in COMMANDS)


def section(title: str, command: str, schema: type) -> str:
    """Return the section of a command: a table of its settings, without those of training a
    classifier, which are named."""
    rows = rows_of(schema)
    lines = [f"\n## {title}\n\n`python {command}`\n"]
    training = rows_of(Config)
    shared = [key for key in rows if training.get(key) == rows[key]]
    if shared and schema is not Config:
        names = "" if schema is ReattackConfig else f" named {', '.join(groups_of(shared))}"
        lines.append(f"Those of training classifiers{names}, and:\n")
        rows = {key: row for key, row in rows.items() if key not in shared}
    lines += ["| setting and default | |", "|---|---|", *rows.values()]
    return "\n".join(lines) + "\n"


def rows_of(schema: type) -> dict[str, str]:
    """Return the rows of a table of settings, by key."""
    return {one.key: row_of(one) for one in settings_of(schema).values()}


def row_of(one: Setting) -> str:
    """Return a setting's row of the table: with its words, as `--help` has the ranges."""
    key = one.key.removesuffix(".name")  # a group is chosen by its own name
    words = allowed_values(one) if one.choices else ""
    return f"| `{key}={as_argument(one.default)}` | {one.help}{words} |"


def groups_of(keys: list[str]) -> list[str]:
    """Return keys as code, those of a section as one."""
    groups = [f"`{key.split('.')[0]}.*`" if "." in key else f"`{key}`" for key in keys]
    return list(dict.fromkeys(groups))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
