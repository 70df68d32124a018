"""Image quilting: the image rebuilt from patches of training images, which no attacker has
touched."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import torch
from torch import Tensor

from moireaug.common.numeric import mirrored_indices
from moireaug.defenses.bank import check_patches, draw_bank
from moireaug.defenses.base import Defence, straight_through

# patches of the image and of the bank at once, whose products stay in the cache
QUERIES_PER_BLOCK, PATCHES_PER_BLOCK = 1024, 2048


@dataclass(frozen=True, eq=False)
class Quilting(Defence):
    """Image quilting (Guo et al. 2018): each patch becomes the nearest of a bank, stitched where
    they agree.

    The image is read in patches on a grid of stride patch - overlap, mirrored where the last goes
    past the border. Each is replaced by the bank's patch at the least L2 distance (the paper's
    K = 1). They are laid left to right, top to bottom; where one overlaps patches laid before, it
    starts behind the minimum-error boundary cut (Efros and Freeman 2001) down its left and along
    its upper overlap, found by dynamic programming rather than by the paper's graph cut.

    Args:
        bank: (N, 3, patch, patch) floating point in [0, 1], N >= 1; see `from_images`. The paper
            takes up to a million patches of 5 x 5. Searched on the images' device.
        patch: side of a patch in pixels. overlap: of neighbouring patches in pixels, at most half a
            patch.

    Time grows with bank and image: 0.7 s for 224 x 224 and 100,000 patches on one core. Backward:
    the identity.

    Raises:
        TypeError, ValueError: a bank of another dtype, shape or range, or an overlap of more than
            half a patch.
    """

    bank: Tensor
    patch: int = 5
    overlap: int = 2

    def __post_init__(self) -> None:
        check_patches(self.patch, self.overlap)
        if not isinstance(self.bank, Tensor) or not self.bank.is_floating_point():
            raise TypeError(
                "Quilting.bank must be a floating-point tensor of patches. Draw one with "
                "from_images."
            )
        if self.bank.shape != (len(self.bank), 3, self.patch, self.patch) or not len(self.bank):
            raise ValueError(
                f"Quilting.bank must have the shape (N, 3, {self.patch}, {self.patch}) with N >= "
                f"1, as patch = {self.patch}; got {tuple(self.bank.shape)}."
            )
        low, high = (v.item() for v in self.bank.aminmax())
        if not (low >= 0 and high <= 1):
            raise ValueError(
                f"Quilting.bank must be finite and lie in [0, 1]; got values from {low:g} to "
                f"{high:g}."
            )

    @classmethod
    def from_images(
        cls,
        images: Tensor | Iterable[Tensor],
        patches: int = 100_000,
        *,
        patch: int = 5,
        overlap: int = 2,
        seed: int = 0,
        cache: str | Path | None = None,
        progress: bool = True,
    ) -> Quilting:
        """Return a quilting whose bank is drawn from training images; arguments as in
        `moireaug.defenses.bank.draw_bank`."""
        check_patches(patch, overlap)
        bank = draw_bank(images, patches, patch=patch, seed=seed, cache=cache, progress=progress)
        return cls(bank, patch, overlap)

    def apply(self, images: Tensor) -> Tensor:
        b, _, h, w = images.shape
        side, stride = self.patch, self.patch - self.overlap
        down, across = (-(-max(n - side, 0) // stride) for n in (h, w))  # ceilings
        rows = mirrored_indices(h, 0, side + down * stride - h, images.device)
        cols = mirrored_indices(w, 0, side + across * stride - w, images.device)
        extended = images.detach()[:, :, rows][..., cols]
        queries = extended.unfold(2, side, stride).unfold(3, side, stride).permute(0, 2, 3, 1, 4, 5)
        nearest = self.nearest(queries.reshape(-1, 3, side, side)).view(b, down + 1, across + 1)
        bank = self.bank.to(images)
        return straight_through(images, stitch(bank, nearest, self.overlap)[..., :h, :w])

    @cached_property
    def _search_vectors(self) -> tuple[Tensor, Tensor]:
        """Return the patches minus their mean in float32, each with minus half its squared length,
        (N, D + 1); and the mean."""
        flat = self.bank.detach().flatten(1).float()
        mean = flat.mean(0)
        flat = flat - mean  # distances of nearly equal patches would drown in rounding
        return torch.cat([flat, -flat.square().sum(1, keepdim=True) / 2], 1), mean

    def nearest(self, patches: Tensor) -> Tensor:
        """Return the index of the bank's nearest patch, (M, 3, patch, patch) to (M,); among equals
        always the same one."""
        bank, mean = (part.to(patches.device) for part in self._search_vectors)
        flat = patches.flatten(1).float() - mean
        flat = torch.cat([flat, flat.new_ones(len(flat), 1)], 1)
        return torch.cat([_nearest_indices(part, bank) for part in flat.split(QUERIES_PER_BLOCK)])


def _nearest_indices(queries: Tensor, bank: Tensor) -> Tensor:
    """Return the index (M,) of the greatest entry of each row of queries @ bank.T, that of the
    nearest patch, without ever holding all of the product."""
    tops = torch.stack([(queries @ block.T).amax(1) for block in bank.split(PATCHES_PER_BLOCK)], 1)
    winner, nearest = tops.argmax(1), queries.new_empty(len(queries), dtype=torch.long)
    # amax alone is many times faster than argmax
    for number, block in enumerate(bank.split(PATCHES_PER_BLOCK)):
        rows = (winner == number).nonzero()[:, 0]
        if len(rows):
            nearest[rows] = (queries[rows] @ block.T).argmax(1) + number * PATCHES_PER_BLOCK
    return nearest


def stitch(bank: Tensor, chosen: Tensor, overlap: int) -> Tensor:
    """Lay the patches (B, rows, cols) chosen from a bank (N, C, side, side) with minimum-error
    boundary cuts: (B, C, side + (rows - 1) stride, side + (cols - 1) stride), of the bank's dtype,
    stride = side - overlap.

    A patch meets those to its left, above and above to the right; so all patches whose column plus
    twice their row is the same are laid at once, in all images.
    """
    b, rows, cols = chosen.shape
    channels, side = bank.shape[1:3]
    stride, device = side - overlap, bank.device
    height, width = side + (rows - 1) * stride, side + (cols - 1) * stride
    canvas = bank.new_zeros(b, height * width, channels)
    channels_last = bank.permute(0, 2, 3, 1)  # as on the canvas
    window = torch.arange(side, device=device)
    window = window[:, None] * width + window
    for front in range(cols + 2 * rows - 2):
        i = torch.arange(
            max(0, (front - cols + 2) // 2), min(rows - 1, front // 2) + 1, device=device
        )
        j = front - 2 * i
        place = ((i * width + j) * stride)[:, None, None] + window  # (n, side, side)
        new = channels_last[chosen[:, i, j]]  # (b, n, side, side, channels)
        if overlap:
            old = canvas[:, place]
            error = (new - old).square().sum(-1)
            fresh = cut(error[..., :overlap]) | (j == 0)[:, None, None]
            new[..., :overlap, :] = torch.where(
                fresh[..., None], new[..., :overlap, :], old[..., :overlap, :]
            )
            # cut along the upper overlap: the same, transposed
            fresh = (cut(error[..., :overlap, :].mT) | (i == 0)[:, None, None]).mT
            new[..., :overlap, :, :] = torch.where(
                fresh[..., None], new[..., :overlap, :, :], old[..., :overlap, :, :]
            )
        canvas[:, place] = new
    return canvas.view(b, height, width, channels).permute(0, 3, 1, 2).contiguous()


def cut(error: Tensor) -> Tensor:
    """Return the minimum-error boundary cut down an overlap, bool: whether the new pixel is taken,
    on the cut and to its right. The cut has one pixel a row, from each row to the next at most one
    column aside, and the least total error (..., length, overlap), the squared difference of the
    old pixel, to the left, and the new one."""
    overlap, far = error.shape[-1], float("inf")
    total, steps = error[..., 0, :], []
    for row in error.unbind(-2)[1:]:
        # from the left, above, the right
        ways = torch.nn.functional.pad(total, (1, 1), value=far).unfold(-1, 3, 1)
        least = ways.min(-1)
        steps.append(least.indices - 1)
        total = row + least.values
    at = total.argmin(-1, keepdim=True)
    path = [at]
    for step in reversed(steps):
        at = at + step.gather(-1, at)
        path.append(at)
    return torch.arange(overlap, device=error.device) >= torch.stack(path[::-1], -2)
