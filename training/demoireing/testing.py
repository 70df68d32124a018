"""Test a trained network on pairs that it was not trained on, simulated and real."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import torch
from torch import Tensor
from tqdm import tqdm

from moireaug.defenses.demoire import DemoireNet
from moireaug.defenses.demoire.tiles import tiled
from moireaug.evaluation.statistics import t_interval
from training.calibration.pairs import find_pairs, read_pairs
from training.demoireing.fidelity import fidelity
from training.demoireing.pairs import test_pairs
from training.demoireing.pictures import Splits
from training.demoireing.schema import DemoireConfig

MEASURES = ("psnr", "ssim", "mapped_psnr", "mapped_ssim")
SHOWN = 300  # pixels of a picture that the report shows
MOST_SHOWN = 12  # real photos that it shows


class GroupedPair(NamedTuple):
    """A photo and the picture that it shows, (3, H, W) uint8 each.

    Args:
        group: its scene's name, or "real photos". kind: "seen" or "unseen" scene, or "real".
        name: of the picture. twin: the same shot without moiré; None for a real photo.
    """

    group: str
    kind: str
    name: str
    photo: Tensor
    original: Tensor
    twin: Tensor | None


class Outcome(NamedTuple):
    """A test's figures and pictures.

    Args:
        scores: one row per pair, reference ("twin" or "original") and state ("photo", "cleaned" or,
            against the original, "twin"), with `MEASURES`, and the seconds and pixels of the
            cleaning.
        shown: the middle of the first pair of every scene, and of the first real ones, with its
            cleaned photo.
    """

    scores: pd.DataFrame
    shown: list[tuple[GroupedPair, Tensor]]


def simulated(cfg: DemoireConfig, splits: Splits) -> Iterator[GroupedPair]:
    """Make the simulated pairs of every scene that the network is tested on."""
    for name, pairs in test_pairs(cfg, splits).items():
        kind = "unseen" if name in cfg.test.unseen else "seen"
        for k in range(cfg.data.test):
            pair = pairs.pair(k)
            yield GroupedPair(name, kind, pair.picture, pair.photo, pair.original, pair.twin)


def real(source: str) -> Iterator[GroupedPair]:
    """Read the real pairs that `pairs=` names.

    Raises:
        ValueError: as `find_pairs` and `read_pairs`.
    """
    for shown in read_pairs(find_pairs(Path(source))):
        if shown.original is not None:
            yield GroupedPair("real photos", "real", shown.name, shown.photo, shown.original, None)


def clean(network: DemoireNet, photo: Tensor) -> Tensor:
    """Return a photo (3, H, W) uint8, cleaned, as 8-bit codes."""
    device = next(network.parameters()).device
    images = photo[None].to(device).float() / 255
    with torch.inference_mode():
        cleaned = tiled(network, images)[0]
    return (255 * cleaned).round().to(torch.uint8).cpu()


def test(network: DemoireNet, cfg: DemoireConfig, splits: Splits) -> Outcome:
    """Clean the photos of all pairs, and compare them with what they should be."""
    found = simulated(cfg, splits)
    if cfg.pairs:
        found = itertools.chain(found, real(cfg.pairs))  # a pair at a time: they may be many
    rows: list[dict[str, Any]] = []
    shown: list[tuple[GroupedPair, Tensor]] = []
    for pair in tqdm(found, desc="Testing", unit="pair", disable=None, leave=False):
        began = time.perf_counter()
        cleaned = clean(network, pair.photo)
        seconds = time.perf_counter() - began
        already = sum(pair.group == other.group for other, _ in shown)
        if already < (MOST_SHOWN if pair.kind == "real" else 1):
            shown.append((middles(pair), middle(cleaned)))
        for row in compared(pair, cleaned):
            rows.append(row | {"seconds": seconds, "pixels": pair.photo[0].numel()})
    return Outcome(pd.DataFrame(rows), shown)


def middles(pair: GroupedPair) -> GroupedPair:
    """Return the middle of each of a pair's pictures."""
    twin = None if pair.twin is None else middle(pair.twin)
    return pair._replace(photo=middle(pair.photo), original=middle(pair.original), twin=twin)


def middle(picture: Tensor) -> Tensor:
    """Return the middle of a picture (3, H, W), at most `SHOWN` pixels wide and high, as a copy: a
    view would keep all of it."""
    top, left = (max(0, (length - SHOWN) // 2) for length in picture.shape[1:])
    return picture[:, top : top + SHOWN, left : left + SHOWN].clone()


def compared(pair: GroupedPair, cleaned: Tensor) -> Iterator[dict[str, Any]]:
    """Yield how close the photo and the cleaned photo are to each reference there is, and the twin
    to the original: what a network that removes all moiré and nothing else would reach."""
    about = {"group": pair.group, "kind": pair.kind, "picture": pair.name}
    for reference in ("twin", "original"):
        wanted = getattr(pair, reference)
        if wanted is None:
            continue
        states = {"photo": pair.photo, "cleaned": cleaned}
        if reference == "original" and pair.twin is not None:
            states["twin"] = pair.twin
        for state, picture in states.items():
            likeness = fidelity(picture.float() / 255, wanted.float() / 255)
            yield about | {"reference": reference, "state": state} | likeness


def summary(scores: pd.DataFrame) -> list[dict[str, Any]]:
    """Return one row per group, reference and measure: the means before and after, the twins' mean
    (None where there are none), the mean gain with its 95 % interval (Student's t over the pairs;
    None for a single one), and how many of the pairs gained."""
    rows = []
    for (group, kind, reference), lines in scores.groupby(
        ["group", "kind", "reference"], sort=False
    ):
        photo = lines[lines.state == "photo"].reset_index()
        cleaned = lines[lines.state == "cleaned"].reset_index()
        twins = lines[lines.state == "twin"]
        for measure in MEASURES:
            gains = (cleaned[measure] - photo[measure]).tolist()
            rows.append(
                {
                    "group": group,
                    "kind": kind,
                    "reference": reference,
                    "measure": measure,
                    "n": len(gains),
                    "before": photo[measure].mean(),
                    "after": cleaned[measure].mean(),
                    "twin": twins[measure].mean() if len(twins) else None,
                    "gain": sum(gains) / len(gains),
                    "gain_interval": list(t_interval(gains)) if len(gains) > 1 else None,
                    "gained": sum(gain > 0 for gain in gains),
                    "milliseconds": 1e3 * cleaned.seconds.median(),
                    "megapixels": cleaned.pixels.median() / 1e6,
                }
            )
    return rows
