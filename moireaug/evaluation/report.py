"""The report of a run: its answer, the ladder, pictures and tables. `summary` is its short form for the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from moireaug.evaluation import page, plots, tables, words
from moireaug.evaluation.page import figure, section
from moireaug.evaluation.words import Metrics, finite, headline, percent, rungs_unanswered, summary

__all__ = ["summary", "write"]


def write(path: Path, metrics: Metrics, pictures: list[dict[str, Any]] | None = None) -> None:
    """Write the report of a run; an older one stays whole until the new one is.

    Args:
        path: of the page; its folder is made where it is missing.
        metrics: what `metrics.json` holds. Entries may be missing; None and NaN stand for unknown.
        pictures: examples, as `page.pictures` takes them.

    Raises:
        ValueError: a picture that is not (H, W, 3) uint8.
    """
    title, paragraphs = headline(metrics)
    paragraphs += rungs_unanswered(metrics)
    seed = metrics.get("seed")
    facts = {
        "data": metrics.get("data"),
        "model": metrics.get("model"),
        "scene": metrics.get("scene_name"),
        "seed": None if seed is None else str(seed),
    }
    times = tables.phases(metrics) + tables.cost(metrics)
    sections = (
        tables.trust(metrics, only="fail"),
        _ladder(metrics),
        page.pictures(pictures or []),
        section("All numbers", tables.rungs(metrics)),
        tables.trust(metrics),
        _training(metrics),
        section("Time", times and f'<div class="beside">{times}</div>'),
        page.made(metrics),
    )
    page.write(path, title, facts, paragraphs, sections, how="report_how.html")


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
    return section("The ladder: what the camera does, and what the attacker", figure(wide, narrow, says, caption))


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
    at = (trains[0] or {}).get("collapsed_at")
    if at is not None:
        caption += (
            f" In epoch {at} this model collapsed (catastrophic overfitting): it defeated the few steps that it was "
            "trained against, and nothing else. It was taken back to its best epoch, and trained on with three steps."
        )
    return section("Training", figure(wide, narrow, "Loss and validation accuracy per epoch", caption))
