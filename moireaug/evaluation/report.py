"""The report of a run: one HTML page that needs nothing but itself. `summary` is its short form for the terminal."""

from __future__ import annotations

import base64
import io
import os
import re
from collections.abc import Sequence
from html import escape
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from PIL import Image

from moireaug.evaluation import plots, tables, words
from moireaug.evaluation.words import Metrics, finite, headline, percent, summary

__all__ = ["summary", "write"]

SHOWN = 165  # small pictures are enlarged to about this many pixels, by a whole factor


def write(path: Path, metrics: Metrics, pictures: list[dict[str, Any]] | None = None) -> None:
    """Write the report of a run; an older one stays whole until the new one is.

    Args:
        path: of the page; its folder is made where it is missing.
        metrics: what `metrics.json` holds. Entries may be missing; None and NaN stand for unknown.
        pictures: examples, each {"label", "cells"}; a cell is {"title", "image": (H, W, 3) uint8} and, where models
            were asked, "predictions": [(model, class, right)].

    Raises:
        ValueError: a picture that is not (H, W, 3) uint8.
    """
    path = Path(path)
    page = _page(metrics, pictures or []).encode("utf-8", "replace")  # a folder may name a class in no known encoding
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        unfinished.write_bytes(page)
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def _page(metrics: Metrics, pictures: Sequence[dict[str, Any]]) -> str:
    title, paragraphs = headline(metrics)
    seed = metrics.get("seed")
    facts = {
        "data": metrics.get("data"),
        "model": metrics.get("model"),
        "scene": metrics.get("scene_name"),
        "seed": None if seed is None else str(seed),
    }
    lead, *others = (f"<p>{_prose(p)}</p>" for p in paragraphs)
    times = tables.phases(metrics) + tables.cost(metrics)
    sections = (
        _ladder(metrics),
        _pictures(pictures),
        _section("All numbers", tables.rungs(metrics)),
        _training(metrics),
        _section("Time", times and f'<div class="beside">{times}</div>'),
        _made(metrics),
    )
    template = resources.files("moireaug.evaluation").joinpath("report_template.html").read_text("utf-8")
    return Template(template).substitute(
        title=_prose(title),
        facts=" · ".join(f"{k}: {escape(str(v))}" for k, v in facts.items() if v),
        headline="\n".join([lead.replace("<p>", '<p class="lead">', 1), *others]),
        body="\n".join(filter(None, sections)),
    )


def _prose(text: str) -> str:
    """Escaped, with every number kept on one line with its unit."""
    for unit in ("%", "points", "=", "s", "min", "h"):
        text = re.sub(rf"(?<=[\dn]) {unit}(?!\w)", f"\N{NO-BREAK SPACE}{unit}", text)
    return escape(text.replace("= ", "=\N{NO-BREAK SPACE}"))


def _section(title: str, *parts: str) -> str:
    """Empty where every part is."""
    if not any(parts):
        return ""
    return "\n".join(["<section>", f"<h2>{escape(title)}</h2>", *filter(None, parts), "</section>"])


def _figure(wide: str, narrow: str, says: str, caption: str) -> str:
    """Both drawings of a plot; the page's width chooses. As images, so that ids in one SVG cannot meet another's."""
    a, b = (f"data:image/svg+xml;base64,{base64.b64encode(svg.encode()).decode()}" for svg in (wide, narrow))
    return (
        f'<figure><picture><source media="(max-width: 640px)" srcset="{b}">'
        f'<img src="{a}" alt="{escape(says)}"></picture><figcaption>{caption}</figcaption></figure>'
    )


def _ladder(metrics: Metrics) -> str:
    rows, theirs = metrics.get("reattack") or [], (metrics.get("baseline") or {}).get("reattack") or []
    if not rows:
        return ""
    gains = {row["name"]: words.gain(metrics, row["name"]) for row in rows} if theirs else {}
    wide, narrow = (plots.ladder(rows, theirs, words.names(metrics), gains, narrow=n) for n in (False, True))
    says = "; ".join(f"{words.title_of(row)}: {percent(finite(row.get('accuracy')))} %" for row in rows)
    caption = (
        "Accuracy rung by rung, with 95 % intervals (Wilson). Above the dashed line nobody searches for anything: each "
        "row shows one more property of the photo. Below it an attacker optimises noise against the model."
    )
    caption += " Gain: this model’s accuracy minus the baseline’s, same images, same shots." if theirs else ""
    says = f"Accuracy of {words.names(metrics)[0]} on every rung. {says}"
    return _section("The ladder: what the camera does, and what the attacker", _figure(wide, narrow, says, caption))


def _pictures(pictures: Sequence[dict[str, Any]]) -> str:
    if not pictures:
        return ""
    examples = []
    for example in pictures:
        cells, label = "\n".join(map(_cell, example.get("cells") or [])), escape(str(example["label"]))
        examples.append(f'<div class="example"><h3>{label}</h3><div class="cells">{cells}</div></div>')
    note = (
        '<p class="note">Each block is one image; its heading is the true class. Under each picture, what the models '
        'answered: <span class="right">✓&nbsp;right</span>, <span class="wrong">✗&nbsp;wrong</span>. Small pictures '
        "are enlarged by whole pixels.</p>"
    )
    return _section("What the models saw", note, *examples)


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


def _training(metrics: Metrics) -> str:
    trains = metrics.get("train"), (metrics.get("baseline") or {}).get("train")
    wide, narrow = (plots.curves(trains, words.names(metrics), narrow=n) for n in (False, True))
    if not wide or not narrow:
        return ""
    caption = (
        "Training, epoch by epoch. Solid: clean images. Dashed: the same images under the adversary that the recipe "
        "trains against; a recipe without one has no dashed line. Rings mark the epoch whose weights were kept. The "
        "losses are of differently perturbed images, so their heights do not compare."
    )
    return _section("Training", _figure(wide, narrow, "Loss and validation accuracy per epoch", caption))


def _made(metrics: Metrics) -> str:
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
    return _section("What was run", *parts)


def _outline(tree: Any, indent: str = "") -> str:
    """Nested dictionaries as indented lines, to be read rather than parsed."""
    if not isinstance(tree, dict):
        return f"{indent}{tree}"
    lines = []
    for key, value in tree.items():
        deeper = isinstance(value, dict) and value
        lines.append(f"{indent}{key}:\n{_outline(value, indent + '  ')}" if deeper else f"{indent}{key}: {value}")
    return "\n".join(lines)
