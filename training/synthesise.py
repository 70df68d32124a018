"""Make pairs of photographed pictures and their originals, as many as wanted, on any number of
machines.

    python training/synthesise.py images=DIR out=DIR n=1000000 scene=phone_at_monitor size=512
    python training/synthesise.py images=DIR out=DIR n=100000 scene=FILE.yaml twin=true
    python training/synthesise.py ... shard=0/16        # the first of 16 commands; counts from 0

Every picture is a crop of `size` pixels from a picture in `images`, at any depth; those that are
damaged or smaller are named and skipped. A pair is `photo`, `original`, with twin=true `twin` (the
same shot without moiré), and the numbers of its shot, which replay it. They are stored in
000000.tar, 000001.tar, ... (WebDataset), or with format=imagefolder in folders of these numbers
with a metadata.csv (Hugging Face datasets), `per_shard` pairs in each. What is in a file depends on
the settings in dataset.json alone: not on the commands, machines or processes that share the work.

If a command is interrupted, the same command continues after the last whole file.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __name__ == "__main__":  # search the repository, not this folder: a user has a models.py too
    sys.path[: not sys.flags.safe_path] = [str(Path(__file__).resolve().parents[1])]

import itertools
import json
import os
import shutil
import time
import uuid
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from omegaconf import MISSING
from torch.utils.data import DataLoader
from tqdm import tqdm

from moireaug.files import remove, unfinished
from moireaug.synthesis import Pairs
from moireaug.synthesis.pictures import NoPictureError
from training.config import scenes
from training.config.plain import parse
from training.config.settings import setting
from training.pairs.files import FORMATS, SUFFIXES, EncodedPair, EncodedPairs
from training.pairs.sets import PairSet, Share, claim, release, share_of
from training.system.locks import locked
from training.system.messages import counted, sentence

EXAMPLE = "python training/synthesise.py images=DIR out=DIR n=1000 scene=phone_at_monitor"

LOST = (
    "a worker process was lost: it was killed, or ran out of memory. Every whole file is kept, and "
    "the same command continues; with fewer workers=N it needs less memory."
)


@dataclass
class Config:
    """All settings of the command."""

    images: str = setting(MISSING, "a folder of pictures")
    out: str = setting(MISSING, "the folder that the pairs go to")
    n: int = setting(MISSING, "pairs, of all commands together")
    scene: str = setting(
        "screen_photo", "a preset's name, or a YAML file of a scene or a list of them"
    )
    size: int = setting(512, "side of the crops, in pixels")
    twin: bool = setting(False, "whether to add the same shot without moiré")
    format: str = setting("webdataset", "of the files", choices=tuple(FORMATS))
    encoding: str = setting("png", "of the pictures", choices=tuple(SUFFIXES))
    quality: int | None = setting(
        None, "of webp and jpeg; null is lossless, and 95 for jpeg", bounds=(1, 100)
    )
    seed: int = setting(0, "of the crops and the shots")
    per_shard: int = setting(1000, "pairs a tar, or a folder", bounds=(1, None))
    shard: str = setting("0/1", "which of how many commands this is, counted from 0")
    workers: int | None = setting(
        None, "processes; 0 is none but this one, null is one for each core", bounds=(0, 1024)
    )


def configure(argv: Sequence[str]) -> Config:
    """Return the settings of a command line.

    Raises:
        ValueError: an unknown key, a value of another type, or out of its bounds.
    """
    settings = parse(argv, Config, EXAMPLE, __doc__)
    check(settings)
    return settings


def check(cfg: Config) -> None:
    """Refuse invalid settings that `Pairs` does not check.

    Raises:
        ValueError: with what was got and what is allowed.
    """
    if cfg.encoding == "png" and cfg.quality is not None:
        raise ValueError("quality= is for encoding=webp and jpeg; PNG is lossless: leave it out.")
    images, out = Path(cfg.images).resolve(), Path(cfg.out).resolve()
    if out.is_relative_to(images):
        raise ValueError(
            f"out={cfg.out} lies in images={cfg.images}, and what is written would be taken for "
            "pictures: name a folder outside it."
        )
    if out.exists() and not out.is_dir():
        raise ValueError(f"out={cfg.out} cannot be a folder: there is a file of that name.")


def settings_of(cfg: Config, pairs: Pairs) -> dict[str, Any]:
    """Return all that the files depend on, as plain values."""
    settings = {
        "n": cfg.n,
        "scene": pairs.scene.to_dict(),
        "size": cfg.size,
        "twin": cfg.twin,
        "format": cfg.format,
        "encoding": cfg.encoding,
        "quality": cfg.quality,
        "seed": cfg.seed,
        "per_shard": cfg.per_shard,
        "images": {"files": len(pairs.pictures), "sha256": pairs.pictures.fingerprint()},
    }
    return json.loads(json.dumps(settings))  # pairs of numbers as lists, as they are read back


def synthesise(cfg: Config) -> None:
    """Make the pairs of this command that are not there yet.

    Raises:
        TypeError, ValueError: invalid settings, or no usable picture.
        OSError: the disk is full or not writable.
    """
    share = share_of(cfg.shard)
    scene = scenes.load(cfg.scene)
    pairs = Pairs(cfg.images, scene, cfg.size, twin=cfg.twin, seed=cfg.seed, n=cfg.n)
    found = PairSet(Path(cfg.out), cfg.n, cfg.per_shard, FORMATS[cfg.format].suffix)
    claim(found.folder, settings_of(cfg, pairs))
    busy = f"another command is at work on shard={cfg.shard} of {found.folder}: wait for it."
    with locked(found.folder / f".shard-{share.mark}.lock", busy):
        for stale in found.folder.glob(f".*.{share.mark}.*.tmp"):  # of a command that was killed
            remove(stale)
        try:
            make(cfg, pairs, found, share)
        except NoPictureError:  # other settings may use the folder
            release(found.folder)
            raise
    others = pairs.pictures.others
    if others:
        print(
            f"Files in {cfg.images} that are not pictures by their names: {len(others)}, "
            f"{_some(others)}."
        )
    left, whole = len(found.missing(Share(0, 1))), len(found.numbers(Share(0, 1)))
    pairs_there = sum(len(found.pairs(number)) for number in found.numbers(Share(0, 1)))
    if left:
        print(f"{found.folder} holds {whole - left} of its {counted(whole, 'file')}.")
    else:
        total = counted(pairs_there, "pair")
        print(f"{found.folder} is complete: {total} in {counted(whole, 'file')}.")


def make(cfg: Config, pairs: Pairs, found: PairSet, share: Share) -> None:
    """Write the files of a share that are missing, and say how long it took."""
    missing = found.missing(share)
    total = sum(len(found.pairs(number)) for number in missing)
    if not total:
        return
    skipped: set[str] = set()
    began = time.perf_counter()
    encoded = EncodedPairs(pairs, cfg.encoding, cfg.quality)
    wanted = itertools.chain.from_iterable(map(found.pairs, missing))
    with tqdm(total=total, unit="pair", disable=None) as bar:
        made = _noted(loader(encoded, wanted, min(workers_of(cfg), total)), bar, skipped)
        for number, group in itertools.groupby(made, lambda pair: pair.index // cfg.per_shard):
            write(found.path(number), group, cfg.format, share)
    seconds = time.perf_counter() - began
    if skipped:
        print(f"{len(skipped)} pictures were skipped, see above; others were drawn instead.")
    print(f"{total} pairs in {seconds:.1f} s: {total / seconds:.1f} pairs per second.")


def loader(encoded: EncodedPairs, wanted: Iterable[int], workers: int) -> DataLoader:
    """Return a loader of pairs in the order of their numbers, from single-threaded processes."""
    return DataLoader(
        encoded,
        batch_size=None,
        sampler=wanted,
        num_workers=workers,
        collate_fn=_as_it_is,  # type: ignore[arg-type]  # without batches it gets a pair
        multiprocessing_context="spawn" if workers else None,  # threads do not survive a fork
    )


def _as_it_is(pair: EncodedPair) -> EncodedPair:
    return pair


def _noted(pairs: Iterable[EncodedPair], bar: tqdm, skipped: set[str]) -> Iterator[EncodedPair]:
    """Pass pairs on, count them, and say which pictures were skipped, each once."""
    for pair in pairs:
        for reason in pair.skipped:
            if reason not in skipped:  # every process finds the same ones
                skipped.add(reason)
                bar.write(f"skipped: {reason}", file=sys.stderr)
        bar.update()
        yield pair


def write(path: Path, pairs: Iterable[EncodedPair], form: str, share: Share) -> None:
    """Write one file of pairs, whole or not at all.

    Raises:
        OSError: the disk is full or not writable; says how many MB are free.
    """
    try:
        with unfinished(path, f"{share.mark}.{uuid.uuid4().hex[:8]}") as beside:
            FORMATS[form].write(beside, pairs)
    except OSError as error:
        free = shutil.disk_usage(path.parent).free / 1e6
        raise OSError(
            f"{path} could not be written ({error.strerror or error}), and {free:.1f} MB are free. "
            "Every whole file is kept. Make room, and run the same command again."
        ) from error


def workers_of(cfg: Config) -> int:
    """Return how many processes are asked for; 0 is this one alone."""
    if cfg.workers is not None:
        return cfg.workers
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))  # of a job that was given some of a machine's cores
    return os.cpu_count() or 1


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")


def main(argv: Sequence[str]) -> None:
    """Run the command line, or exit with a one-line error."""
    torch.set_num_threads(1)
    try:
        synthesise(configure(argv))
    except KeyboardInterrupt:
        print(
            "\nInterrupted. Every whole file is kept; the same command continues.", file=sys.stderr
        )
        raise SystemExit(130) from None
    except (ValueError, TypeError, OSError) as error:
        raise SystemExit(f"error: {sentence(error)}") from None
    except RuntimeError as error:
        if not str(error).startswith("DataLoader worker"):
            raise
        raise SystemExit(f"error: {LOST}") from None


if __name__ == "__main__":
    main(sys.argv[1:])
