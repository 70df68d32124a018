"""The bank of patches that quilting draws on: drawn uniformly from training images, kept in a
file."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Iterable, Sized
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from moireaug.common.argument_checks import check_whole
from moireaug.common.files import write_bytes
from moireaug.common.image_checks import check_images
from moireaug.common.progress import progress_bar


def check_patches(patch: int, overlap: int) -> None:
    """Refuse an overlap of more than half a patch, and sizes that are not whole numbers."""
    check_whole("patch", patch, 1)
    check_whole("overlap", overlap, 0)
    if 2 * overlap > patch:
        raise ValueError(f"overlap must be at most half of patch = {patch} pixels; got {overlap}.")


def draw_bank(
    images: Tensor | Iterable[Tensor],
    patches: int = 100_000,
    *,
    patch: int = 5,
    seed: int = 0,
    cache: str | Path | None = None,
    progress: bool = True,
) -> Tensor:
    """Draw patches uniformly, without repetition, from all patches of the images.

    Args:
        images: (B, 3, H, W) float in [0, 1], sRGB codes; or an iterable of such batches, alone or
            first in a tuple with labels, as loaders give them. Read once, so a stream of any length
            will do. Sizes may differ.
        patches: how many to draw; fewer if the images hold fewer.
        patch: side in pixels.
        seed: of the draw's own generator. The same images in the same order give the same bank,
            however batched.
        cache: a file (.npz) of its own for each data set, whose bank is returned without a new draw
            if it was drawn with the same settings: patches, patch, seed, and the images' content if
            they are one tensor, otherwise the type and length of the iterable and its `dataset`.
        progress: show a bar.

    Returns:
        (N, 3, patch, patch) float32, N <= patches, on the CPU.

    Raises:
        TypeError, ValueError: settings or images out of range, images smaller than a patch, no
            images at all, or a cache that is a folder.
    """
    check_whole("patches", patches, 1)
    check_whole("patch", patch, 1)
    check_whole("seed", seed, 0, 2**63 - 1)
    patches, patch, seed = int(patches), int(patch), int(seed)  # NumPy's, for some
    if isinstance(images, Tensor):
        images = check_images(images)
    if cache is not None and Path(cache).is_dir():
        raise ValueError(
            f"cache must be a file; {cache} is a folder. Name a file in it, such as bank.npz."
        )
    if cache is None:
        return _draw(images, patches, patch, seed, progress)
    settings = {"patches": patches, "patch": patch, "seed": seed, "images": _content(images)}
    key = json.dumps(settings, sort_keys=True)
    bank = _read(Path(cache), key)
    if bank is None:
        bank = _draw(images, patches, patch, seed, progress)
        content = io.BytesIO()
        np.savez(content, key=key, bank=bank.numpy())
        write_bytes(Path(cache), content.getbuffer())
    return bank


def _draw(
    images: Tensor | Iterable[Tensor], patches: int, patch: int, seed: int, progress: bool
) -> Tensor:
    """Return a bank: every patch draws a number, and those with the smallest are in it."""
    generator = torch.Generator("cpu").manual_seed(seed)
    keys = torch.empty(0, dtype=torch.float64, device="cpu")
    bank = torch.empty(0, 3, patch, patch, dtype=torch.float32, device="cpu")
    batches = images.split(32) if isinstance(images, Tensor) else images
    for batch in progress_bar(batches, enabled=progress, desc="patches", unit="batch"):
        batch = batch[0] if isinstance(batch, (tuple, list)) else batch
        batch = check_images(batch)
        if min(batch.shape[-2:]) < patch:
            raise ValueError(
                f"images must be at least {patch} x {patch}, the size of a patch; got "
                f"{batch.shape[-2]} x {batch.shape[-1]}. Leave small ones out, or ask for a "
                "smaller patch."
            )
        windows = batch.detach().unfold(2, patch, 1).unfold(3, patch, 1).permute(0, 2, 3, 1, 4, 5)
        shape = windows.shape[:3]
        drawn = torch.rand(shape, generator=generator, dtype=torch.float64, device="cpu")
        limit = keys.max() if len(keys) == patches else 1.0  # which no number reaches
        chosen = (drawn < limit).nonzero()
        if len(chosen) > patches:
            chosen = chosen[drawn[tuple(chosen.T)].topk(patches, largest=False).indices]
        new = windows[tuple(chosen.to(batch.device).T)].float().cpu()
        keys, bank = torch.cat([keys, drawn[tuple(chosen.T)]]), torch.cat([bank, new])
        if len(keys) > patches:
            keys, best = keys.topk(patches, largest=False)
            bank = bank[best]
    if not len(bank):
        raise ValueError("images must hold at least one image; got none. Is the iterable used up?")
    return bank[keys.argsort()]  # an order that does not depend on the batches


def _content(images: Tensor | Iterable[Tensor]) -> str:
    if isinstance(images, Tensor):
        digest = hashlib.sha256()
        if images.numel():
            content = images.detach().cpu().contiguous().view(torch.uint8)
            digest.update(content.flatten().numpy().data)
        return f"{tuple(images.shape)} {images.dtype} {digest.hexdigest()}"
    descriptions = []
    for part in (images, getattr(images, "dataset", None)):
        if part is not None:
            length = len(part) if isinstance(part, Sized) else "?"
            descriptions.append(f"{type(part).__name__} {length}")
    return " ".join(descriptions)


def _read(file: Path, key: str) -> Tensor | None:
    """Return the bank of that key, or None where the file is missing, broken or of another key."""
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as content:
            return torch.from_numpy(content["bank"]) if str(content["key"]) == key else None
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
        return None
