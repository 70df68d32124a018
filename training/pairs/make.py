"""Make the pairs of a share and write them, file by file."""

import itertools
import os
import shutil
import statistics
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import MISSING
from torch.utils.data import DataLoader
from tqdm import tqdm

from moireaug.common.files import atomic_replacement
from moireaug.synthesis import Pairs
from moireaug.synthesis.pairs import make_pair
from moireaug.synthesis.twins import SEEN_CODES
from training.config.schema import SHRINK_HELP
from training.config.settings import setting
from training.pairs.files import FORMATS, SUFFIXES, EncodedPair, EncodedPairs
from training.pairs.sets import PairSet, Share
from training.system.messages import count_text

MOIRE_SAMPLE_PAIRS = 16  # pairs whose moiré is told before the work begins


@dataclass
class Config:
    """All settings of the command."""

    images: str = setting(MISSING, "folder of pictures")
    out: str = setting(MISSING, "folder of the pairs")
    n: int = setting(MISSING, "pairs, over all shards")
    scene: str = setting("screen_photo", "preset, or YAML file of a scene or a list")
    shrink: Any = setting(None, SHRINK_HELP, example="[1,3]")
    size: int = setting(512, "side of the crops, in pixels")
    twin: bool = setting(False, "add the same photo without moiré")
    raw: bool = setting(False, "add the raw image, as raw.npy in uint16")
    format: str = setting("webdataset", "of the files", choices=tuple(FORMATS))
    encoding: str = setting("png", "of the pictures", choices=tuple(SUFFIXES))
    quality: int | None = setting(
        None, "of webp and jpeg; null: lossless, and 95 for jpeg", bounds=(1, 100)
    )
    seed: int = setting(0, "of the crops and photos")
    per_shard: int = setting(1000, "pairs a tar, or a folder", bounds=(1, None))
    shard: str = setting("0/1", "i/n: part i of n, from 0")
    workers: int | None = setting(
        None, "processes; 0: this one, null: one per core", bounds=(0, 1024)
    )


def make(cfg: Config, pairs: Pairs, pair_set: PairSet, share: Share) -> None:
    """Write the missing files of a share, and print the time."""
    missing = pair_set.missing(share)
    total = sum(len(pair_set.pairs(number)) for number in missing)
    if not total:
        return
    print(moire_of_sample(pairs, min(total, MOIRE_SAMPLE_PAIRS)))
    skipped: set[str] = set()
    start = time.perf_counter()
    encoded = EncodedPairs(pairs, cfg.encoding, cfg.quality, cfg.raw)
    numbers = itertools.chain.from_iterable(map(pair_set.pairs, missing))
    with tqdm(total=total, unit="pair", disable=None) as bar:
        loaded = loader(encoded, numbers, min(workers_of(cfg), total))
        encoded_pairs = _with_progress(loaded, bar, skipped)
        files = itertools.groupby(encoded_pairs, lambda pair: pair.index // cfg.per_shard)
        for number, group in files:
            write(pair_set.path(number), group, cfg.format, share)
    seconds = time.perf_counter() - start
    if skipped:
        print(f"{len(skipped)} pictures were skipped, see above; others were drawn instead.")
    print(f"{total} pairs in {seconds:.1f} s: {total / seconds:.1f} pairs per second.")


def moire_of_sample(pairs: Pairs, n: int) -> str:
    """Measure the moiré of the first pairs of a set, with or without twins; return a sentence."""
    moire: list[float] = []
    pictures = pairs.pictures.subset(range(len(pairs.pictures)))  # which names its own skipped ones
    for k in range(n):
        pair = make_pair(k, pictures, pairs.scene, pairs.size, twin=True, seed=pairs.seed)
        moire.append(pair.moire or 0.0)  # there is a twin
    share_seen = sum(one > SEEN_CODES for one in moire) / n
    return (
        f"Moiré of the first {count_text(n, 'pair')}, photo minus the same without: median "
        f"{statistics.median(moire):.2g} codes RMS, {100 * share_seen:.0f} % above {SEEN_CODES:g}."
    )


def loader(encoded: EncodedPairs, numbers: Iterable[int], workers: int) -> DataLoader:
    """Return a loader of pairs in the order of their numbers, from single-threaded processes."""
    return DataLoader(
        encoded,
        batch_size=None,
        sampler=numbers,
        num_workers=workers,
        collate_fn=_as_it_is,  # type: ignore[arg-type]  # without batches it gets a pair
        multiprocessing_context="spawn" if workers else None,  # threads do not survive a fork
    )


def _as_it_is(pair: EncodedPair) -> EncodedPair:
    return pair


def _with_progress(
    pairs: Iterable[EncodedPair], bar: tqdm, reasons: set[str]
) -> Iterator[EncodedPair]:
    """Pass pairs on, count them, and print the pictures that were skipped, each once."""
    for pair in pairs:
        for reason in pair.skipped:
            if reason not in reasons:  # every process finds the same ones
                reasons.add(reason)
                bar.write(f"skipped: {reason}", file=sys.stderr)
        bar.update()
        yield pair


def write(path: Path, pairs: Iterable[EncodedPair], format_name: str, share: Share) -> None:
    """Write one file of pairs, whole or not at all.

    Raises:
        OSError: the disk is full or not writable; says how many MB are free.
    """
    try:
        with atomic_replacement(path, share.label) as temporary:
            FORMATS[format_name].write(temporary, pairs)
    except OSError as error:
        free = shutil.disk_usage(path.parent).free / 1e6
        raise OSError(
            f"{path} could not be written ({error.strerror or error}), and {free:.1f} MB are free. "
            "Every whole file is kept. Make room, and run the same command again."
        ) from error


def workers_of(cfg: Config) -> int:
    """Return the number of processes; 0 is this one alone."""
    if cfg.workers is not None:
        return cfg.workers
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))  # of a job that was given some of a machine's cores
    return os.cpu_count() or 1
