"""What do demoiréing networks and plain filters give real photos of screens?

    python benchmarks/demoireing.py PAIRS.csv --every 8
    python benchmarks/demoireing.py PAIRS.csv --networks screen runs/demoire/weights.pt

PAIRS.csv has the columns photo and original, aligned. Each photo is cleaned by the networks and by
three filters, and compared with its original: PSNR after the best colour map onto it, and the
moiré of colour and luma that is left in its flat regions (`training.photographs.statistics`,
sigma 1.5 to 8 px). What the photo has more of than the original is the excess: the last columns
say which share of all photos' excess is removed. A filter that blurs the photo shows what PSNR is
worth where pairs are aligned to a pixel; originals, cleaned, show what a network does to a photo
without moiré. Writes results/demoireing.csv, a row for each picture.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import kornia.color
import pandas as pd
import torch
from kornia.filters import bilateral_blur
from torch import Tensor

from benchmarks import measure
from benchmarks.common_corruptions import blur
from moireaug.defenses import demoire
from training.comparison.intervals import t_interval
from training.data.real_pairs import find_pairs, read_pairs
from training.demoireing.clean import clean_codes
from training.photographs import statistics

Clean = Callable[[Tensor], Tensor]  # a photo (3, H, W) in [0, 1]
LUMA_SIGMA, COLOUR_SIGMA = 0.8, 4.0  # pixels
PHOTO, ORIGINAL = "photo", "original"


def blur_colour(photo: Tensor) -> Tensor:
    """Blur the colour more than the luma, as eyes hardly see it."""
    sharp, soft = (
        kornia.color.rgb_to_ycbcr(blur(photo[None], sigma)) for sigma in (LUMA_SIGMA, COLOUR_SIGMA)
    )
    return kornia.color.ycbcr_to_rgb(torch.cat([sharp[:, :1], soft[:, 1:]], 1))[0].clamp(0, 1)


def bilateral(photo: Tensor) -> Tensor:
    return bilateral_blur(photo[None], 9, 0.1, (3.0, 3.0))[0]


def by_network(network: demoire.DemoireNet, photo: Tensor) -> Tensor:
    return clean_codes(network, (255 * photo).round().byte()).float() / 255


FILTERS: dict[str, Clean] = {
    "bilateral filter, 9 px": bilateral,
    "Gaussian blur, 0.6 px": lambda photo: blur(photo[None], 0.6)[0],
    "Gaussian blur, colour 4 px, luma 0.8 px": blur_colour,
}


def rows_of(
    name: str, photo: Tensor, original: Tensor, cleaners: Mapping[str, Clean]
) -> Iterator[dict[str, Any]]:
    """Yield the figures of a photo and its original (3, H, W) in [0, 1], as they are and cleaned by
    each cleaner."""
    for picture, image in ((PHOTO, photo), (ORIGINAL, original)):
        cleaned = {"nothing": image} | {by: clean(image) for by, clean in cleaners.items()}
        for by, result in cleaned.items():
            (numbers,) = statistics.measure(result[None], original[None])
            kept = {key: numbers[key] for key in ("psnr_mapped", "chroma", "luma")}
            yield {"pair": name, "picture": picture, "cleaned by": by} | kept


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each cleaner: the gain in PSNR over all photos with its 95 % interval, how
    many photos gain, the share of the excess of colour and of luma that is removed, and the mean
    PSNR of cleaned originals."""
    of = rows.set_index(["cleaned by", "picture"]).sort_index(kind="stable")
    before, target = of.loc["nothing", PHOTO], of.loc["nothing", ORIGINAL]
    table = []
    for by in dict.fromkeys(rows["cleaned by"]):
        after = of.loc[by, PHOTO]
        gains = after.psnr_mapped.to_numpy() - before.psnr_mapped.to_numpy()
        low, high = t_interval(gains.tolist())
        row = {"cleaned by": by, "n": len(gains), "PSNR": after.psnr_mapped.mean()}
        row |= {"gain": gains.mean(), "low": low, "high": high, "gained": int((gains > 0).sum())}
        for kind in ("chroma", "luma"):
            excess = before[kind].sum() - target[kind].sum()
            row[f"{kind} removed"] = (before[kind].sum() - after[kind].sum()) / excess
        row["original, PSNR"] = of.loc[by, ORIGINAL].psnr_mapped.mean()
        table.append(row)
    return pd.DataFrame(table)


def main() -> None:
    parser = measure.arguments(__doc__)
    parser.add_argument("pairs", type=Path, help="a CSV file with the columns photo and original")
    parser.add_argument("--every", type=int, default=1, metavar="K", help="take each K-th pair")
    parser.add_argument(
        "--networks", nargs="+", default=["screen"], help="'screen', or weights that a run wrote"
    )
    args, count, _ = measure.begin(parser, None, 2)  # pairs; None: all
    try:
        networks = {name: demoire.load(name).eval() for name in args.networks}
        pairs = list(read_pairs(find_pairs(args.pairs)[:: args.every][:count]))
    except (ValueError, OSError) as error:
        parser.error(str(error))
    cleaners = {name: partial(by_network, network) for name, network in networks.items()}
    rows: list[dict[str, Any]] = []
    with torch.no_grad():
        for name, photo, original in pairs:
            assert original is not None  # of a file of pairs
            rows += rows_of(name, photo / 255, original / 255, cleaners | FILTERS)
    table = pd.DataFrame(rows)
    table.to_csv(measure.results(args) / "demoireing.csv", index=False, float_format="%.6g")
    print(measure.text_of(summary(table)))


if __name__ == "__main__":
    main()
