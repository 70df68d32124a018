"""Write docs/settings.md: every setting of every command, as it is declared.

Run it as `python docs/settings.py`, after a setting has changed.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]


from training import calibrate, synthesise
from training.config.compose import allowed_values
from training.config.schema import Config, ReattackConfig
from training.config.settings import as_argument, settings_of
from training.demoireing import clean
from training.demoireing.schema import DemoireConfig

PAGE = Path(__file__).with_suffix(".md")
INTRODUCTION = """# Settings

Each is given as `key=value` after a command, and printed by the command's `--help`. `null` is no
value. A path is taken as it is, with `~` expanded.
"""
COMMANDS = (
    ("Training classifiers", "training/fit.py", Config),
    ("Attacking trained classifiers", "training/reattack.py", ReattackConfig),
    ("Training demoiréing networks", "training/demoire.py train", DemoireConfig),
    ("Cleaning photos", "training/demoire.py clean", clean.Config),
    ("Making pairs", "training/synthesise.py", synthesise.Config),
    ("Calibrating a scene", "training/calibrate.py", calibrate.Config),
)


def page() -> str:
    """Return the page."""
    parts = [INTRODUCTION.rstrip() + "\n"]
    described: dict[str, str] = {}
    for title, command, schema in COMMANDS:
        parts.append(f"\n## {title}\n\n`python {command}`\n")
        rows = []
        for one in settings_of(schema).values():
            key = one.key.removesuffix(".name")  # a group is chosen by its own name
            description = f"{one.facts.help}{allowed_values(one)}"
            row = f"| `{key}` | `{as_argument(one.default)}` | {description} |"
            if schema is ReattackConfig and described.get(key) == row:
                continue
            described[key] = row
            rows.append(row.replace("``", ""))
        if schema is ReattackConfig:
            parts.append("Those of training, and:\n")
        parts.append("\n".join(["| setting | default | |", "|---|---|---|", *rows]) + "\n")
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
