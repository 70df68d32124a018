"""Test a trained network on pairs that it was not trained on, simulated and real."""

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
from moireaug.evaluation.visibility import psnr, ssim
from training.comparison.intervals import t_interval
from training.data.real_pairs import find_pairs, read_pairs
from training.demoireing.clean import clean_codes
from training.demoireing.pairs import test_pairs
from training.demoireing.pictures import Splits
from training.demoireing.schema import DemoireConfig
from training.photographs.tone import ColourMap
from training.report.page import middle_of

MEASURES = ("psnr", "ssim", "mapped_psnr", "mapped_ssim")
MAX_REAL_EXAMPLES = 12


class GroupedPair(NamedTuple):
    """A photo and the picture on its screen.

    Args:
        group: name of its scene, or "real photos".
        kind: "seen" or "unseen", of its scene, or "real".
        photo, original: photo and picture, (3, H, W) uint8.
        twin: the same shot without moiré; None for a real photo.
    """

    group: str
    kind: str
    name: str
    photo: Tensor
    original: Tensor
    twin: Tensor | None


class CleaningResult(NamedTuple):
    """The figures and pictures of a test.

    Args:
        scores: one row per pair, reference ("twin" or "original") and state ("photo", "cleaned" or,
            against the original, "twin"), with `MEASURES`, and the seconds and pixels of the
            cleaning.
        examples: the middle of the first pair of every scene, and of the first real ones, with its
            cleaned photo.
    """

    scores: pd.DataFrame
    examples: list[tuple[GroupedPair, Tensor]]


def simulated_pairs(cfg: DemoireConfig, splits: Splits) -> Iterator[GroupedPair]:
    """Make the simulated pairs of every scene that the network is tested on."""
    for name, pairs in test_pairs(cfg, splits).items():
        kind = "unseen" if name in cfg.test.unseen else "seen"
        for k in range(cfg.data.test):
            pair = pairs.pair(k)
            yield GroupedPair(name, kind, pair.picture, pair.photo, pair.original, pair.twin)


def real_pairs(source: str) -> Iterator[GroupedPair]:
    """Read the real pairs of `pairs=`."""
    for screen_photo in read_pairs(find_pairs(Path(source))):
        name, photo, original = screen_photo
        if original is not None:
            yield GroupedPair("real photos", "real", name, photo, original, None)


def test_network(network: DemoireNet, cfg: DemoireConfig, splits: Splits) -> CleaningResult:
    """Clean the photos of all pairs, and compare them with their references."""
    pairs = simulated_pairs(cfg, splits)
    if cfg.pairs:
        pairs = itertools.chain(pairs, real_pairs(cfg.pairs))  # a pair at a time: they may be many
    rows: list[dict[str, Any]] = []
    examples: list[tuple[GroupedPair, Tensor]] = []
    for pair in tqdm(pairs, desc="Testing", unit="pair", disable=None, leave=False):
        start = time.perf_counter()
        cleaned = clean_codes(network, pair.photo)
        seconds = time.perf_counter() - start
        count = sum(pair.group == earlier.group for earlier, _ in examples)
        if count < (MAX_REAL_EXAMPLES if pair.kind == "real" else 1):
            examples.append((middle_of_pair(pair), middle_of(cleaned)))
        for row in compare_pair(pair, cleaned):
            rows.append(row | {"seconds": seconds, "pixels": pair.photo[0].numel()})
    return CleaningResult(pd.DataFrame(rows), examples)


def middle_of_pair(pair: GroupedPair) -> GroupedPair:
    """Return the middle of each of a pair's pictures."""
    twin = None if pair.twin is None else middle_of(pair.twin)
    return pair._replace(photo=middle_of(pair.photo), original=middle_of(pair.original), twin=twin)


def compare_pair(pair: GroupedPair, cleaned: Tensor) -> Iterator[dict[str, Any]]:
    """Yield the likeness of the photo and of the cleaned photo to each reference that there is, and
    of the twin to the original, which a network would reach that removes all moiré and nothing
    else."""
    labels = {"group": pair.group, "kind": pair.kind, "picture": pair.name}
    for reference in ("twin", "original"):
        target = getattr(pair, reference)
        if target is None:
            continue
        states = {"photo": pair.photo, "cleaned": cleaned}
        if reference == "original" and pair.twin is not None:
            states["twin"] = pair.twin
        for state, picture in states.items():
            likeness = fidelity_scores(picture.float() / 255, target.float() / 255)
            yield labels | {"reference": reference, "state": state} | likeness


def summarise(scores: pd.DataFrame) -> list[dict[str, Any]]:
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


def map_colours(picture: Tensor, target: Tensor) -> Tensor:
    """Return a picture (3, H, W) in [0, 1] after the best global colour map onto another."""
    codes, aim = (255 * side.float().cpu().contiguous().numpy() for side in (picture, target))
    return torch.from_numpy(ColourMap.fit(codes, aim)(codes)) / 255


def fidelity_scores(picture: Tensor, target: Tensor) -> dict[str, float]:
    """Return `psnr` in dB and `ssim` of a picture (3, H, W) in [0, 1] against another, and with the
    prefix `mapped_` those after the best global colour map."""
    scores = {}
    for prefix, candidate in (("", picture), ("mapped_", map_colours(picture, target))):
        scores[f"{prefix}psnr"] = float(psnr(candidate[None], target[None]))
        scores[f"{prefix}ssim"] = float(ssim(candidate[None], target[None]))
    return scores
