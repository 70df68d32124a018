"""Score the photos of a folder: which are of screens?

    python training/detect.py score in=DIR detector=runs/detect/detector.pt

Writes scores.csv into out=DIR. Where photos lie in folders whose names start with the word "real"
or "screen", at any depth, these are taken for the truth, and the folders of in=DIR that hold them
for collections: AUC, equal error rate, APCER and BPCER are printed for each, with 95 % intervals,
and written with a plot of the ROC curves and a sheet of the mistakes (screens that were missed,
then other photos called screens)."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from omegaconf import MISSING
from tqdm import tqdm

from moireaug.common.files import write_bytes, write_text
from moireaug.common.image_files import read_picture
from moireaug.synthesis.pictures import Pictures
from training.config.plain_commands import parse, report_errors
from training.config.settings import setting
from training.detection.fit import score_of
from training.detection.labelled import collection_of, readable, truth_of
from training.detection.measures import MISTAKES, line_of, measures, roc_plot, sheet
from training.detection.network import Detector, shrunk
from training.system.files import make_folder, require_outside

EXAMPLE = "python training/detect.py score in=DIR detector=runs/detect/detector.pt"


@dataclass
class Config:
    """All settings of the command."""

    in_: str = setting(MISSING, "folder of photos")
    detector: str = setting(MISSING, "file by training/detect.py train")
    out: str = setting("runs/scores", "folder of the results")


def require_judgeable(names: Iterable[str]) -> None:
    """Refuse photos whose truth is known where no collection holds both kinds, so that the detector
    could not be judged."""
    kinds: dict[str, set[bool]] = {}
    for name in names:
        if (is_screen := truth_of(name)) is not None:
            kinds.setdefault(collection_of(name), set()).add(is_screen)
    is_split = all(len(of_collection) == 1 for of_collection in kinds.values())
    if is_split and len(set().union(*kinds.values())) == 2:
        collections = ", ".join(name or "." for name in sorted(kinds))
        raise ValueError(
            "a detector is judged on collections that hold both real photos and screens, and none "
            f"of {collections} does: put both kinds into one folder, as in "
            "DIR/all/real and DIR/all/screen, or give their folders other names."
        )


def score(cfg: Config) -> pd.DataFrame:
    """Score, measure, write and print; return the table of scores.

    Raises:
        ValueError: no photos that can be read, a file that holds no detector, or labels of one kind
            in each collection.
        OSError: the disk is full or not writable.
    """
    out = Path(cfg.out)
    require_outside(out, cfg.in_, "in")
    detector, pictures = Detector.load(cfg.detector), Pictures(cfg.in_, 1)
    require_judgeable(pictures.names)
    make_folder(out, "out=DIR")
    rows: list[dict[str, Any]] = []
    progress = tqdm(pictures.names, unit="photo", disable=None)
    for name, picture in readable(pictures.folder, progress):
        found = score_of(detector, picture)
        rows.append({"photo": name, "score": found, "screen": found > detector.threshold.item()})
    if not rows:
        raise ValueError(
            f"none of the {len(pictures)} photos in {pictures.folder} could be scored, see above: "
            "pass a folder of others."
        )
    table = pd.DataFrame(rows)
    require_judgeable(table.photo)
    for earlier in ("measures.json", "roc.png", "mistakes.png"):  # of other photos
        (out / earlier).unlink(missing_ok=True)
    write_text(out / "scores.csv", table.to_csv(index=False))
    print(
        f"Screens: {int(table.screen.sum())} of {len(table)} photos. Written: {out / 'scores.csv'}"
    )
    table["truth"] = [truth_of(name) for name in table.photo]
    if set(table.truth.dropna()) == {False, True}:
        judge(table[table.truth.notna()], detector.threshold.item(), pictures.folder, out)
    return table


def judge(table: pd.DataFrame, threshold: float, folder: Path, out: Path) -> None:
    """Measure how well the scores tell the truth, by collection; write and print.

    Args:
        table: a row for each photo: photo, score, truth. folder: of the photos.
    """
    scores: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for name, rows in table.groupby(table.photo.map(collection_of)):
        is_screen = rows.truth.astype(bool)
        if is_screen.nunique() == 2:
            scores[str(name) or "."] = (
                rows.score[is_screen].to_numpy(),
                rows.score[~is_screen].to_numpy(),
            )
    found = {name: measures(*both, threshold) for name, both in scores.items()}
    write_text(out / "measures.json", json.dumps(found, indent=1))
    write_bytes(out / "roc.png", roc_plot(scores))
    is_screen = table.truth.astype(bool)
    is_flagged = table.score > threshold
    missed = table[is_screen & ~is_flagged].nsmallest(MISTAKES, "score").photo
    alarms = table[~is_screen & is_flagged].nlargest(MISTAKES, "score").photo
    mistakes = []
    for names in (missed, alarms):  # as large as they are, all at once would fill the memory
        mistakes.append([shrunk(read_picture(folder / name)) for name in names])
    write_bytes(out / "mistakes.png", sheet(mistakes))
    for name, row in found.items():
        print(line_of(name, row))
    mean = np.mean([row["auc"] for row in found.values()])
    print(f"Mean AUC of {len(found)}: {mean:.3f}. Written: {out / 'measures.json'}")


configure = partial(parse, schema=Config, example=EXAMPLE, description=__doc__)


def main(argv: Sequence[str]) -> None:
    """Run the command line, or exit with a one-line error."""
    with report_errors("Interrupted before the scores were written."):
        score(configure(argv))
