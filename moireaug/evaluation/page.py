"""The frame of every report: one HTML page that needs nothing but itself."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Mapping, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from PIL import Image

from moireaug.evaluation.store import write_text
from moireaug.evaluation.words import Metrics

SHOWN = 165  # small pictures are enlarged to about this many pixels, by a whole factor
EXPLAINED = (
    '<p class="note">Each block is one image; its heading is the true class. Under each picture, what the models '
    'answered: <span class="right">✓&nbsp;right</span>, <span class="wrong">✗&nbsp;wrong</span>. Small pictures '
    "are enlarged by whole pixels.</p>"
)


def write(
    path: Path, title: str, facts: Mapping[str, Any], paragraphs: Sequence[str], sections: Sequence[str], how: str
) -> None:
    """Write a page; an older one stays whole until the new one is.

    Args:
        path: of the page; its folder is made where it is missing.
        title: the answer in one line. facts: what it is about, under the title; empty ones are left out.
        paragraphs: the answer at length, as plain text. sections: HTML; empty ones are left out.
        how: name of the file that says how to read it.
    """
    lead, *others = (f"<p>{prose(p)}</p>" for p in paragraphs)
    template, reading = (
        resources.files("moireaug.evaluation").joinpath(name).read_text("utf-8")
        for name in ("report_template.html", how)
    )
    write_text(path, Template(template).substitute(
        title=prose(title),
        facts=" · ".join(f"{k}: {escape(str(v))}" for k, v in facts.items() if v not in (None, "")),
        headline="\n".join([lead.replace("<p>", '<p class="lead">', 1), *others]),
        body="\n".join(filter(None, sections)),
        how=reading,
    ))  # fmt: skip


def prose(text: str) -> str:
    """Escaped, with every number kept on one line with its unit."""
    for unit in ("%", "points", "=", "s", "min", "h"):
        text = re.sub(rf"(?<=[\dn]) {unit}(?!\w)", f"\N{NO-BREAK SPACE}{unit}", text)
    return escape(text.replace("= ", "=\N{NO-BREAK SPACE}"))


def section(title: str, *parts: str) -> str:
    """Empty where every part is."""
    if not any(parts):
        return ""
    return "\n".join(["<section>", f"<h2>{escape(title)}</h2>", *filter(None, parts), "</section>"])


def figure(wide: str, narrow: str, says: str, caption: str) -> str:
    """Both drawings of a plot; the page's width chooses. As images, so that ids in one SVG cannot meet another's."""
    a, b = (f"data:image/svg+xml;base64,{base64.b64encode(svg.encode()).decode()}" for svg in (wide, narrow))
    return (
        f'<figure><picture><source media="(max-width: 640px)" srcset="{b}">'
        f'<img src="{a}" alt="{escape(says)}"></picture><figcaption>{caption}</figcaption></figure>'
    )


def pictures(shown: Sequence[dict[str, Any]]) -> str:
    """What the models saw, as a section; `shown` as in `examples`. Empty where there is nothing."""
    return section("What the models saw", *(shown and [EXPLAINED, examples(shown)]))


def examples(shown: Sequence[dict[str, Any]]) -> str:
    """Blocks of pictures with what the models answered.

    Args:
        shown: {"label", "cells"} each; a cell is {"title", "image": (H, W, 3) uint8} and, where models were asked,
            "predictions": [(model, class, right)].

    Raises:
        ValueError: a picture that is not (H, W, 3) uint8.
    """
    blocks = []
    for example in shown:
        cells, label = "\n".join(map(_cell, example.get("cells") or [])), escape(str(example["label"]))
        blocks.append(f'<div class="example"><h3>{label}</h3><div class="cells">{cells}</div></div>')
    return "\n".join(blocks)


def _cell(cell: dict[str, Any]) -> str:
    image, title = np.asarray(cell["image"]), str(cell["title"])
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise ValueError(
            f"The picture {title!r} must be a uint8 array (height, width, 3); got {image.dtype} {image.shape}. "
            "Convert a [0, 1] float image with (255 * image).round().astype(numpy.uint8)."
        )
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG")
    height, width = image.shape[:2]
    factor = max(1, round(SHOWN / max(height, width)))
    sharp = ' style="image-rendering: pixelated"' if factor > 1 else ""
    answers = [
        f'<li><span class="{"right" if right else "wrong"}"><b>{"✓" if right else "✗"}</b></span>'
        f'<span class="who">{escape(str(model))}:</span> {escape(str(said))}</li>'
        for model, said, right in cell.get("predictions") or []
    ]
    return (
        f'<div class="cell" style="width: {max(width * factor, 130)}px">'
        f'<img src="data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}" width="{width * factor}" '
        f'height="{height * factor}" alt="{escape(title)}"{sharp}><span class="title">{escape(title)}</span>'
        + (f"<ul>{''.join(answers)}</ul></div>" if answers else "</div>")
    )


def made(metrics: Metrics) -> str:
    """What was run: plan, command, versions and settings."""
    parts = []
    if plan := metrics.get("plan"):
        scene = escape(str(metrics.get("scene_name") or "this run"))
        parts.append(f"<h3>Scene {scene}: what light goes through</h3>\n<pre>{escape(str(plan))}</pre>")
    if command := metrics.get("command"):
        parts.append(f'<h3>Command</h3>\n<pre class="command">{escape(str(command))}</pre>')
    if environment := metrics.get("environment"):
        facts = " · ".join(f"{escape(str(k))}&nbsp;{escape(str(v))}" for k, v in environment.items())
        parts.append(f"<h3>Versions and machine</h3>\n<p>{facts}</p>")
    for title, tree in (("Configuration", metrics.get("config")), ("Scene, every field", metrics.get("scene"))):
        if tree:
            parts.append(f"<details><summary>{title}</summary>\n<pre>{escape(_outline(tree))}</pre></details>")
    return section("What was run", *parts)


def _outline(tree: Any, indent: str = "") -> str:
    """Nested dictionaries as indented lines, to be read rather than parsed."""
    if not isinstance(tree, dict):
        return f"{indent}{tree}"
    lines = []
    for key, value in tree.items():
        deeper = isinstance(value, dict) and value
        lines.append(f"{indent}{key}:\n{_outline(value, indent + '  ')}" if deeper else f"{indent}{key}: {value}")
    return "\n".join(lines)
