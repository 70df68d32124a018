"""What networks answer to originals and to their photos, before they are tuned and after."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from moireaug.evaluation.statistics import paired_gain, wilson

SURE = 0.7  # probability of the answer to an original


class Pictures(NamedTuple):
    """Originals and real photos, each (N, 3, S, S) uint8."""

    originals: Tensor
    photos: Tensor

    def subset(self, chosen: Tensor) -> Pictures:
        """Return some of the pairs, by (N,) bool."""
        return Pictures(self.originals[chosen], self.photos[chosen])


@torch.no_grad()
def answers(classifier: nn.Module, pictures: Tensor) -> Tensor:
    """Return the classes (N,) that a classifier gives pictures (N, 3, S, S) uint8."""
    return torch.cat([classifier(part / 255).argmax(1) for part in pictures.split(32)])


class Answered(NamedTuple):
    """What a network answers to originals and photos (N,)."""

    originals: Tensor
    photos: Tensor


def row_of(before: Answered, after: Answered) -> dict[str, Any]:
    """Return shares of equal answers of a network before and after tuning, with 95 % intervals, and
    the gain of photos that are answered as the original was before."""
    row: dict[str, Any] = {"n": len(before.originals)}
    kept = after.photos == before.originals
    for kind, same in (
        ("original as before", after.originals == before.originals),
        ("photo as original", after.photos == after.originals),
        ("photo as original before", kept),
    ):
        row[kind] = same.double().mean().item()
        row[f"{kind}, low"], row[f"{kind}, high"] = wilson(int(same.sum()), len(same))
    gain = paired_gain(kept, before.photos == before.originals)
    row["gain"], row["gain, low"], row["gain, high"] = gain
    return row


def halves(count: int) -> tuple[Tensor, Tensor]:
    """Return which of a number of pairs are judged, by half."""
    first = torch.arange(count) < count // 2
    return first, ~first


def answered(networks: Sequence[nn.Module], pictures: Pictures) -> Answered:
    """Return what networks answer, each to the half of the pairs that did not train it."""
    of_halves = []
    for network, rows in zip(networks, halves(len(pictures.photos)), strict=True):
        part = pictures.subset(rows)
        of_halves.append((answers(network, part.originals), answers(network, part.photos)))
    return Answered(*(torch.cat(parts) for parts in zip(*of_halves, strict=True)))


@torch.no_grad()
def is_sure(classifier: nn.Module, pictures: Tensor) -> Tensor:
    """Return of which pictures (N, 3, S, S) uint8 a classifier is sure, (N,)."""
    parts = [classifier(part / 255).softmax(1).amax(1) for part in pictures.split(32)]
    return torch.cat(parts) >= SURE


def rows_of(
    name: str,
    students: Mapping[tuple[str, str], Sequence[nn.Module]],
    judged: Mapping[str, Pictures],
) -> Iterator[dict[str, Any]]:
    """Yield a row for each tuning of a classifier, average and kind of pairs.

    Args:
        students: the networks for the two halves; first the classifier before tuning, twice.
    """
    teachers = next(iter(students.values()))
    for pairs, pictures in judged.items():
        before = answered(teachers, pictures)
        sure = is_sure(teachers[0], pictures.originals)
        for (training, weights), networks in students.items():
            after = answered(networks, pictures)
            for part, rows in ((pairs, torch.ones_like(sure)), (f"{pairs}, sure", sure)):
                if not rows.any():
                    continue
                kinds = {
                    "classifier": name,
                    "pairs": part,
                    "tuned on": training,
                    "weights": weights,
                }
                chosen = (Answered(*(one[rows] for one in both)) for both in (before, after))
                yield kinds | row_of(*chosen)
