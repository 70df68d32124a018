"""Make pairs of photographed pictures and their originals, as many as wanted, on any number of
machines.

    python training/synthesise.py images=DIR out=DIR n=1000000 scene=phone_at_monitor size=512
    python training/synthesise.py images=DIR out=DIR n=100000 scene=FILE.yaml twin=true
    python training/synthesise.py ... shard=0/16        # the first of 16 commands; counts from 0

Every picture is a crop of `size` pixels from a picture in `images`, at any depth; those that are
damaged or smaller are named and skipped. A pair is `photo`, `original`, with twin=true `twin` (the
same shot without moiré), with raw=true `raw` (the sensor's reading), and the numbers of its shot,
which replay it. They are stored in 000000.tar, 000001.tar, ... (WebDataset), or with
format=imagefolder in folders of these numbers with a metadata.csv (Hugging Face datasets),
`per_shard` pairs in each. What is in a file depends on the settings in dataset.json alone: not on
the commands, machines or processes that share the work.

If a command is interrupted, the same command continues after the last whole file.
"""

import sys
from pathlib import Path

if __name__ == "__main__":  # search the repository, not this folder: a user has a models.py too
    sys.path[: not sys.flags.safe_path] = [str(Path(__file__).resolve().parents[1])]

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from moireaug.common.files import remove
from moireaug.synthesis import Pairs
from training.config import scenes
from training.config.plain_commands import parse, report_errors
from training.pairs.files import FORMATS
from training.pairs.make import Config, make
from training.pairs.sets import PairSet, Share, claim, share_of
from training.system.files import locked, require_outside
from training.system.messages import count_text

EXAMPLE = "python training/synthesise.py images=DIR out=DIR n=1000 scene=phone_at_monitor"


def configure(argv: Sequence[str]) -> Config:
    """Return the settings of a command line."""
    settings = parse(argv, Config, EXAMPLE, __doc__)
    check(settings)
    return settings


def check(cfg: Config) -> None:
    """Refuse invalid settings that `Pairs` does not check."""
    if cfg.encoding == "png" and cfg.quality is not None:
        raise ValueError("quality= is for encoding=webp and jpeg; PNG is lossless: leave it out.")
    out = Path(cfg.out)
    require_outside(out, cfg.images, "images")
    if out.exists() and not out.is_dir():
        raise ValueError(f"out={cfg.out} cannot be a folder: there is a file of that name.")


def file_settings(cfg: Config, pairs: Pairs) -> dict[str, Any]:
    """Return the settings that the files depend on, as plain values."""
    settings = {
        "n": cfg.n,
        "scene": pairs.scene.to_dict(),
        "size": cfg.size,
        "twin": cfg.twin,
        "raw": cfg.raw,
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
    scene = scenes.load(cfg.scene, cfg.shrink)
    pairs = Pairs(cfg.images, scene, cfg.size, twin=cfg.twin, seed=cfg.seed, n=cfg.n)
    pair_set = PairSet(Path(cfg.out), cfg.n, cfg.per_shard, FORMATS[cfg.format].suffix)
    # before the folder is claimed: other settings may find a usable picture
    pairs.pictures.subset(range(len(pairs.pictures))).draw(np.random.default_rng(0))
    claim(pair_set.folder, file_settings(cfg, pairs))
    busy = f"another command is at work on shard={cfg.shard} of {pair_set.folder}: wait for it."
    with locked(pair_set.folder / f".shard-{share.label}.lock", busy):
        # of a command that was killed
        for stale in pair_set.folder.glob(f".*.{share.label}.*.tmp"):
            remove(stale)
        make(cfg, pairs, pair_set, share)
    others = pairs.pictures.others
    if others:
        names = ", ".join(others[:5]) + (", ..." if len(others) > 5 else "")
        print(
            f"Files in {cfg.images} that are not pictures by their names: {len(others)}, {names}."
        )
    everything = Share(0, 1)
    files, missing = pair_set.numbers(everything), pair_set.missing(everything)
    file_count = count_text(len(files), "file")
    if missing:
        print(f"{pair_set.folder} holds {len(files) - len(missing)} of its {file_count}.")
    else:
        print(f"{pair_set.folder} is complete: {count_text(cfg.n, 'pair')} in {file_count}.")


def main(argv: Sequence[str]) -> None:
    """Run the command line, or exit with a one-line error."""
    torch.set_num_threads(1)
    with report_errors("Interrupted. Every whole file is kept; the same command continues."):
        synthesise(configure(argv))


if __name__ == "__main__":
    main(sys.argv[1:])
