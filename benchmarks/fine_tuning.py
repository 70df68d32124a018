"""Does tuning on simulated photos help a classifier on real photos of screens?

    python benchmarks/fine_tuning.py PAIRS.csv --classifiers DIR
    python benchmarks/fine_tuning.py PAIRS.csv --loose PAIRS2.csv --classifiers DIR

Each ImageNet classifier of DIR, and each EfficientNet-Lite whose package is installed
(published_weights.py), is tuned by the recipe moire_tune on crops of the originals of half of the
pairs in PAIRS.csv (columns photo and original, aligned), without labels: it learns to answer
photographed pictures as it answered the pictures before. The other half is judged, and then the
halves change places. Controls take the photos' place: their twins without moiré (blur, tone and
noise alone), blur with JPEG and changed colours, and sinusoids; the mark to reach are the real
photos of the same originals.

Prints on what share of the pairs a network answers the original as before, and the real photo as
the original: as its own answer to it, and as the one before, with the gain over no tuning; for all
pairs, and for those of which the network is sure. Pairs of --loose show one object without being
aligned. Each network is judged as trained, and averaged with the original as the recipe would.
Writes results/fine_tuning.csv.
"""

from __future__ import annotations

import copy
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import pandas as pd
import torch
from hydra import compose, initialize
from torch import Tensor, nn
from torchvision.transforms import v2

from benchmarks import measure
from benchmarks.agreement import CLASSES, read_classifiers, shrunk
from benchmarks.other_libraries import overlay
from benchmarks.published_weights import efficientnet_lite, efficientnets_lite
from benchmarks.tuned_answers import Pictures, halves, rows_of
from training.classifier.adversaries import TrainingAdversary
from training.classifier.original import keep_answers
from training.classifier.train import classifier_of, train_model
from training.config.compose import RECIPE_GROUPS, register
from training.config.schema import Config, as_config
from training.data.real_pairs import ScreenPhoto, find_pairs, read_codes, read_pairs
from training.data.splits import Splits
from training.models.classifiers import OWN_MODELS
from training.runs.run import Run

Photograph = Callable[[Tensor], Tensor]
VALIDATION_DIVISOR = 8  # an eighth of the pairs that train is left for validation
CROP_AREA = (0.5, 1.0)  # of a picture


@dataclass(frozen=True)
class Effort:
    """Side of the pictures in pixels; crops of an epoch, and epochs; seed of the training."""

    side: int = 224
    train: int = 960
    epochs: int = 2
    seed: int = 0


QUICK_SETTINGS = Effort(side=64, train=4, epochs=1)


class Treatment(NamedTuple):
    """What takes half of each batch: photos in a scene, with moiré or without, images that a
    function changes in their place, or their real photos."""

    scene: str = "anywhere"
    moire: bool = True
    photograph: Photograph | None = None
    is_real: bool = False


class Rival(TrainingAdversary):
    """Changes images in place of photographing them.

    Args:
        change: of images (B, 3, H, W) in [0, 1].
    """

    def __init__(self, change: Photograph) -> None:
        self.change, self.attack = change, None

    def photograph(self, images: Tensor) -> Tensor:
        return self.change(images)


def degrade(images: Tensor) -> Tensor:
    """Blur images, change their colours and compress them, each by draws of its own."""
    change = v2.Compose(
        [v2.GaussianBlur(5, (0.1, 2.0)), v2.ColorJitter(0.4, 0.4, 0.4, 0.05), v2.JPEG((40, 90))]
    )
    codes = (255 * images).round().to(torch.uint8)
    return torch.stack([change(one) for one in codes]) / 255


TREATMENTS: dict[str, Treatment] = {
    "anywhere": Treatment(),
    "anywhere without moiré": Treatment(moire=False),
    "screen_photo": Treatment("screen_photo"),
    "screen_photo without moiré": Treatment("screen_photo", moire=False),
    "blur, colour and JPEG": Treatment(photograph=degrade),
    "a sinusoid in each colour": Treatment(photograph=overlay),
    "real photos": Treatment(is_real=True),
}


def settings_of(treatment: Treatment, weights: Path, effort: Effort) -> Config:
    """Return the settings of the recipe for one network and treatment."""
    register("fine_tuning", Config, RECIPE_GROUPS, None)
    with initialize(version_base="1.3", config_path=None):
        cfg = as_config(compose("fine_tuning", ["recipe=moire_tune"]))
    return replace(
        cfg,
        seed=effort.seed,
        model=weights.stem,
        weights=str(weights),
        scene=treatment.scene,
        data=replace(cfg.data, size=effort.side, train=effort.train, augment="none"),
        adversary=replace(cfg.adversary, moire=treatment.moire),
        train=replace(cfg.train, epochs=effort.epochs),
    )


def tuned(cfg: Config, splits: Splits, photograph: Photograph | None) -> dict[str, nn.Module]:
    """Return a network tuned by the recipe, as trained, and averaged with the one before so that it
    keeps `train.kept` of its answers."""
    with tempfile.TemporaryDirectory() as folder:
        run = Run(replace(cfg, runs=folder, train=replace(cfg.train, kept=0.0)))
        run.prepare()
        classifier = classifier_of(run.config, splits.num_classes)
        assert classifier.original
        if photograph:
            classifier.adversary = classifier.validation_adversary = Rival(photograph)
        _, cost = train_model(run, splits, classifier=classifier)
        model = classifier.model.eval()
        students = {"as trained": copy.deepcopy(model)}
        share = keep_answers(model, classifier.original, splits.val, cfg.train.kept).new_share
    print(f"{cfg.model}: {cost.wall_seconds:.0f} s, {share:.0%} new", file=sys.stderr, flush=True)
    return students | {"averaged": model}


def draw_crops(pairs: Sequence[ScreenPhoto], count: int, side: int) -> Pictures:
    """Draw crops of pairs, each of the original and the photo at one place, half of them mirrored;
    the draws are always the same."""
    originals, photos = [], []
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        for number in range(count):
            pair = pairs[number % len(pairs)]
            assert pair.original is not None
            both = torch.stack([pair.original, pair.photo])
            place = v2.RandomResizedCrop.get_params(both, list(CROP_AREA), [3 / 4, 4 / 3])
            crops = v2.functional.resized_crop(both, *place, [side, side])
            crops = crops.flip(-1) if torch.rand(()) < 0.5 else crops
            originals.append(crops[0])
            photos.append(crops[1])
    return Pictures(torch.stack(originals), torch.stack(photos))


def splits_of(crops: Pictures, validation: Pictures) -> Splits:
    """Return the originals as data of no label."""
    train, val = ([(image, 0) for image in part.originals] for part in (crops, validation))
    return Splits(train, val, val, {}, CLASSES)  # type: ignore[arg-type]


def real_photos(*parts: Pictures) -> Photograph:
    """Return a function that takes images (B, 3, S, S) in [0, 1] for their real photos."""
    photo_of = {}
    for part in parts:
        for original, photo in zip(part.originals, part.photos, strict=True):
            photo_of[original.numpy().tobytes()] = photo

    def photograph(images: Tensor) -> Tensor:
        codes = (255 * images).round().byte()
        return torch.stack([photo_of[one.numpy().tobytes()] for one in codes]) / 255

    return photograph


def read_whole(table: Path, side: int) -> Pictures:
    """Read pairs whole, shrunk to squares."""
    pictures: tuple[list[Tensor], list[Tensor]] = ([], [])
    for pair in find_pairs(table):
        for whole, path in zip(pictures, (pair.original, pair.photo), strict=True):
            small = shrunk(read_codes(path)[None] / 255, side)
            whole.append((255 * small).round().byte())
    return Pictures(*map(torch.cat, pictures))


def tune_halves(
    weights: Path, treatment: Treatment, pairs: Sequence[ScreenPhoto], effort: Effort
) -> Iterable[dict[str, nn.Module]]:
    """Yield a classifier tuned for each half of the pairs, on the other half."""
    cfg = settings_of(treatment, weights, effort)
    for judged in halves(len(pairs)):
        others = [pair for pair, is_judged in zip(pairs, judged, strict=True) if not is_judged]
        validated = max(1, len(others) // VALIDATION_DIVISOR)
        crops = draw_crops(others[validated:], effort.train, effort.side)
        validation = draw_crops(others[:validated], 4 * validated, effort.side)
        photograph = treatment.photograph
        if treatment.is_real:
            photograph = real_photos(crops, validation)
        yield tuned(cfg, splits_of(crops, validation), photograph)


def save_efficientnets_lite(folder: Path) -> dict[str, Path]:
    """Save the weights of the installed EfficientNets-Lite for the recipe, which then knows these
    networks, and return their files."""
    files = {}
    for name, classifier in efficientnets_lite().items():
        OWN_MODELS[name] = partial(efficientnet_lite, int(name[-1]))
        files[name] = folder / f"{name}.pth"
        torch.save(classifier.state_dict(), files[name])
    return files


def main() -> None:
    parser = measure.arguments(__doc__)
    parser.add_argument("pairs", type=Path, help="a CSV file with the columns photo and original")
    parser.add_argument("--loose", type=Path, help="one of pairs that are not aligned")
    parser.add_argument(
        "--classifiers", type=Path, required=True, help="a folder of files such as resnet18.pth"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the training: order and photos")
    parser.add_argument("--crops", type=int, help="of an epoch; 960, the recipe's are 3,200")
    parser.add_argument("--epochs", type=int, help="2, the recipe's are 5")
    parser.add_argument("--only", nargs="+", choices=TREATMENTS, default=list(TREATMENTS))
    args, effort, _ = measure.begin(parser, Effort(), QUICK_SETTINGS)
    train, epochs = args.crops or effort.train, args.epochs or effort.epochs
    effort = replace(effort, seed=args.seed, train=train, epochs=epochs)
    try:
        teachers = read_classifiers(args.classifiers) | efficientnets_lite()
        pairs = list(read_pairs(find_pairs(args.pairs)))
        tables = [args.pairs, *([args.loose] if args.loose else [])]
        judged = {table.stem: read_whole(table, effort.side) for table in tables}
    except (ValueError, OSError) as error:
        parser.error(str(error))
    files = {name: args.classifiers / f"{name}.pth" for name in teachers}
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        files |= save_efficientnets_lite(Path(folder))
        for name, teacher in teachers.items():
            students: dict[tuple[str, str], list[nn.Module]] = {}
            students["nothing", "its own"] = [teacher] * 2
            for training in args.only:
                for networks in tune_halves(files[name], TREATMENTS[training], pairs, effort):
                    for kind, network in networks.items():
                        students.setdefault((training, kind), []).append(network)
            trained = {"seed": effort.seed, "crops": effort.train, "epochs": effort.epochs}
            rows += [trained | row for row in rows_of(name, students, judged)]
    measure.publish(pd.DataFrame(rows), measure.results(args) / "fine_tuning.csv")


if __name__ == "__main__":
    main()
