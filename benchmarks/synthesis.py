"""What a million pairs cost: core time and bytes of a pair, by size, encoding and twin.

    python benchmarks/synthesis.py          # from the one photograph that comes with matplotlib
    python benchmarks/synthesis.py DIR      # from pictures of your own

Makes, encodes and writes the pairs of training/synthesise.py in one process of one thread. Times
are those that the process spends on a core, medians over pairs, so that other load hardly matters;
a million pairs are a million times that, on as many cores as there are. Writes
results/synthesis.json.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import matplotlib.cbook

from benchmarks import measure
from benchmarks.measure import Timing
from moireaug.synthesis import Pairs
from training.pairs.files import EncodedPair, encode_pair, write_tar

FULL_SETTINGS: dict[str, Any] = {"sizes": (256, 512), "pairs": 24}
QUICK_SETTINGS: dict[str, Any] = {"sizes": (16,), "pairs": 2}
SCENE = "phone_at_monitor"
ENCODINGS = (("png", None), ("webp", None), ("webp", 90), ("jpeg", 95))
MILLION = 1_000_000


def main() -> None:
    parser = measure.arguments(__doc__)
    parser.set_defaults(threads=1)
    parser.add_argument("images", nargs="?", type=Path, help="a folder of pictures")
    args, settings, facts = measure.begin(parser, FULL_SETTINGS, QUICK_SETTINGS)
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        rows = list(
            measure_pairs(args.images or portrait(scratch), scratch / "pairs.tar", settings)
        )
    print(f"A pair in {SCENE}: core time in ms, pairs per second and core, and a million of them")
    print(report(rows))
    measure.write_json(args, "synthesis", metadata=facts, settings=settings, scene=SCENE, rows=rows)


def portrait(folder: Path) -> Path:
    """Return a folder with one photograph, a JPEG file of 512 x 600 pixels."""
    shutil.copy(matplotlib.cbook.get_sample_data("grace_hopper.jpg", asfileobj=False), folder)
    return folder


def measure_pairs(images: Path, tar: Path, settings: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a row for each size, twin and encoding."""
    for size in settings["sizes"]:
        for twin in (False, True):
            pairs = Pairs(images, SCENE, size, twin=twin)
            pairs.make_pair(0)  # compiles, or loads what is compiled
            taken = [piece(pairs, k, tar) for k in range(settings["pairs"])]
            for i, (encoding, quality) in enumerate(ENCODINGS):
                rows = [of_pair[i] for of_pair in taken]
                found: dict[str, Any] = {"encoding": encoding, "quality": quality}
                for name in ("make", "encode", "write", "whole"):
                    found[name] = Timing.of([row[name] for row in rows])._asdict()
                found["bytes"] = sum(row["bytes"] for row in rows) / len(rows)
                yield {"size": size, "twin": twin} | found


def piece(pairs: Pairs, k: int, tar: Path) -> list[dict[str, float]]:
    """Return seconds on a core, and bytes, of one pair in every encoding."""
    began = time.process_time()
    pair = pairs.make_pair(k)
    make = time.process_time() - began
    found = []
    for encoding, quality in ENCODINGS:
        began = time.process_time()
        files = encode_pair(pair, encoding, quality)
        encoded = time.process_time()
        write_tar(tar, [EncodedPair(k, files, pair.to_dict(), [])])
        write = time.process_time() - encoded
        encode = encoded - began
        size = sum(map(len, files.values()))
        whole = make + encode + write
        found.append(
            {"make": make, "encode": encode, "write": write, "whole": whole, "bytes": size}
        )
    return found


def report(rows: list[dict[str, Any]]) -> str:
    lines = []
    for row in rows:
        name = row["encoding"]
        if row["quality"]:
            name += f" {row['quality']}"
        elif name == "webp":
            name += " lossless"
        line = {"px": row["size"], "twin": row["twin"], "encoding": name}
        for part in ("make", "encode", "write", "whole"):
            line[part], quartiles = measure.in_ms(row[part])
        seconds = row["whole"]["median"]
        line |= {"quartiles": quartiles, "pairs/s": 1 / seconds, "kB a pair": row["bytes"] / 1e3}
        line |= {"core hours": MILLION * seconds / 3600, "GB": MILLION * row["bytes"] / 1e9}
        lines.append(line)
    return measure.text_of_rows(lines)


if __name__ == "__main__":
    main()
