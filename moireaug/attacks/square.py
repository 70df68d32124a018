"""A Moiré Attack that sees only logits: random search in place of gradients."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from moireaug.attacks.losses import LOSSES
from moireaug.attacks.moire import MoireAttack
from moireaug.attacks.problem import Point
from moireaug.attacks.search import Iterates, Search
from moireaug.common.numeric import select_rows, widen_half

FIRST_WINDOW_SHARE = 0.8  # of the planes' area, as in AutoAttack
# queries of 10,000 after which that share is halved: Andriushchenko et al. (2020), section 4.1 and
# its code
HALVING_QUERIES = (10, 50, 200, 500, 1000, 2000, 4000, 6000, 8000)


@dataclass(frozen=True, kw_only=True)
class SquareMoire(MoireAttack):
    """Random search for raw noise in the manner of the Square Attack (Andriushchenko et al., 2020,
    Algorithms 1 and 2): starts from vertical stripes of +-eps, then sets square windows of
    shrinking side to +-eps, one sign per plane, and keeps those that raise an image's loss. The
    model needs no gradient. With `bound="codes"`, +-eps are the ends of each value's interval.

    Args:
        steps: queries per restart that try noise: one for the stripes, one for each window. One
            more follows on the noise that is kept; with `until_fooled`, a restart's first query is
            asked twice, until the model has once repeated its answer. The call's last queries judge
            the result, and the images without noise.
        loss: a key of `attacks.LOSSES`, which a window must raise.
        others: see `MoireAttack`. Settings that only gradients use keep their defaults: step_size,
            rule, random_start, optimise and eot.

    Raises:
        ValueError: another value for one of those.
    """

    loss: str = "margin"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("step_size", "rule", "random_start", "optimise", "eot"):
            default = type(self).__dataclass_fields__[name].default
            if getattr(self, name) != default:
                raise ValueError(
                    "SquareMoire searches the noise of one shot at random and has no use for "
                    f"{name} = {getattr(self, name)!r}; leave it out."
                )

    def _start(self, search: Search, restart: int) -> Point:
        """Return vertical stripes: one sign per column, plane and image."""
        point, shape = super()._start(search, restart), search.problem.shape
        n, planes, _, columns = shape
        signs = _signs((n, planes, 1, columns), search.generator).to(point["noise"])
        return {"noise": self.eps * signs.expand(shape)}

    def iterates(self, search: Search, restart: int = 0) -> Iterates:
        """Yield the noise of each query, and the best of it."""
        point = best = self._start(search, restart)
        highest = torch.full_like(search.labels, -math.inf, dtype=torch.float64)
        for query in range(self.steps):
            logits = search.active_logits(point)
            labels, targets = search.active_goals(search.loss_targets)
            loss = LOSSES[self.loss](widen_half(logits), labels, targets)
            # no loss, of an image without an answer, is below any other
            loss = search.scatter(loss.nan_to_num(-math.inf, math.inf, -math.inf))
            better = (loss > highest) if query else torch.ones_like(loss, dtype=torch.bool)
            highest = torch.where(better, loss.to(highest), highest)
            best = {"noise": select_rows(better, point["noise"], best["noise"])}
            size = window_side(query, self.steps, search.problem.shape)
            window = {"noise": _with_square(best["noise"], self.eps, size, search.generator)}
            yield point, logits
            point = window
        yield best, None


def window_side(query: int, steps: int, shape: tuple[int, ...]) -> int:
    """Return the side of the window that is tried after `query` of `steps` queries, on planes of
    `shape` (..., h, w): `FIRST_WINDOW_SHARE` of their area, halved at the paper's query counts,
    scaled to `steps`."""
    h, w = shape[-2:]
    halvings = sum(query / steps > halving / 10_000 for halving in HALVING_QUERIES)
    share = FIRST_WINDOW_SHARE / 2**halvings
    return max(1, min(round((share * h * w) ** 0.5), h, w))


def _with_square(noise: Tensor, eps: float, size: int, generator: torch.Generator | None) -> Tensor:
    """Return the noise (B, C, h, w) with a window at a random place of each image set to +-eps, one
    sign per plane."""
    n, planes, h, w = noise.shape
    places = torch.tensor([h - size + 1, w - size + 1], device="cpu")[:, None, None]
    drawn = torch.rand(2, n, 1, generator=generator, dtype=torch.float32, device="cpu")
    corner = drawn * places
    signs = _signs((n, planes, 1, 1), generator).to(noise)
    top, left = corner.floor().to(noise.device)
    rows, columns = (torch.arange(m, device=noise.device) for m in (h, w))
    down, across = (rows >= top) & (rows < top + size), (columns >= left) & (columns < left + size)
    return torch.where(down[:, None, :, None] & across[:, None, None, :], eps * signs, noise)


def _signs(shape: tuple[int, ...], generator: torch.Generator | None) -> Tensor:
    return torch.randint(0, 2, shape, generator=generator, device="cpu") * 2 - 1
