"""What a step of training costs: by recipe, by option, and beside the loading of its images.

    python benchmarks/training_steps.py

A step is forward, backward and update of the recipes' classifier on the CPU, on one batch of
photographs: attention_convnet at 48 px, beside which the camera weighs something, and resnet18 at
224 px, beside which it does not. The small one takes steps of Muon, the large one of SGD, as
fine-tuning does. Loading is the recipes' own over a folder of JPEG files, made for the purpose:
each pass decodes the files, which the system's cache holds, or, as from the second
epoch on without workers, reads the images that are kept in memory. Prints three tables and writes
results/training_steps.json.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import torch
from hydra import compose, initialize
from PIL import Image
from torch.utils.data import DataLoader

from benchmarks import measure
from benchmarks.problems import images
from training.classifier.adversaries import passes
from training.classifier.train import classifier_of
from training.classifier.tuning import make_optimizer, tuning_of
from training.config.compose import RECIPE_GROUPS, register
from training.config.schema import RECIPES, Config, as_config
from training.data.batches import Batches
from training.data.load import load
from training.system import machine

# models: name, batch, side of its images
FULL_SETTINGS = {
    "models": (("attention_convnet", 64, 48), ("resnet18", 8, 224)),
    "repeats": 9,
    "warmup": 2,
    "files": 192,
    "sides": (48, 256),
    "compile": True,
}
QUICK_SETTINGS = {
    "models": (("small_resnet", 2, 24),),
    "repeats": 1,
    "warmup": 0,
    "files": 4,
    "sides": (16,),
    "compile": False,
}
# what a pass of the loader reads, and its workers
READ_SOURCES = (("files", 0), ("files", 2), ("memory", 0))
MAX_MUON_SIDE = 64  # px; networks of larger images take steps of SGD
OPTIONS = {
    "as it is": [],
    "train.compile=true": ["train.compile=true"],
    "trainer.precision=32-true": ["trainer.precision=32-true"],
    "trainer.precision=bf16-mixed": ["trainer.precision=bf16-mixed"],
}


def main() -> None:
    args, settings, facts = measure.begin(measure.arguments(__doc__), FULL_SETTINGS, QUICK_SETTINGS)
    with initialize(version_base="1.3", config_path=None):
        found = {
            "recipes": recipes(settings),
            "options": options(settings),
            "loading": loading(settings),
        }
    models = "; ".join(f"{m}, {side} px, batch {n}" for m, n, side in settings["models"])
    titles = {
        "recipes": f"A step of each recipe: {models}",
        "options": "Options of moire_at",
        "loading": "Loading images, and the training that they are loaded for (clean), images/s",
    }
    for name, title in titles.items():
        print(title, measure.text_of_rows(found[name]), sep="\n", end="\n\n")
    measure.write_json(args, "training_steps", metadata=facts, settings=settings, **found)


def recipes(settings: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a row for each model and recipe: the time of a step."""
    rows = []
    for model, batch, side in settings["models"]:
        configured, calls = {}, {}
        for path in sorted(RECIPES.glob("*.yaml")):
            cfg = configure(f"recipe={path.stem}", f"model={model}")
            configured[path.stem] = cfg
            calls[path.stem] = step(cfg, batch, side)
        times = measure.timed_together(calls, settings["repeats"], settings["warmup"], budget=60.0)
        for name in sorted(times, key=lambda name: times[name].median):
            rows.append(
                {
                    "model": model,
                    "recipe": name,
                    "seconds": times[name]._asdict(),
                    "relative": times[name].median / times["clean"].median,
                    "passes": passes(configured[name].adversary, configured[name].train.target),
                }
            )
    return rows


def options(settings: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a row for each model and each option that is meant for speed."""
    rows = []
    for model, batch, side in settings["models"]:
        chosen = {k: v for k, v in OPTIONS.items() if settings["compile"] or "compile" not in k}
        recipe = ["recipe=moire_at", f"model={model}"]
        calls = {
            name: step(configure(*recipe, *given), batch, side) for name, given in chosen.items()
        }
        times = measure.timed_together(calls, settings["repeats"], settings["warmup"])
        plain = times["as it is"].median
        rows += [
            {"model": model, "option": name, "seconds": t._asdict(), "relative": t.median / plain}
            for name, t in times.items()
        ]
    return rows


register("training_steps", Config, RECIPE_GROUPS, __doc__)


def configure(*overrides: str) -> Config:
    """Return the settings that these overrides of fit.py give on the CPU, where steps are taken."""
    return as_config(compose("training_steps", ["trainer.accelerator=cpu", *overrides]))


def step(
    cfg: Config, batch: int, side: int, device: torch.device | str = "cpu"
) -> Callable[[], None]:
    """Return a step of training, always on the same batch, outside Lightning's loop."""
    torch.manual_seed(0)
    device = torch.device(device)
    model = classifier_of(cfg, 16).to(device)
    model._strength, model.log = (lambda: 1.0), (lambda *args, **kwargs: None)  # type: ignore[method-assign]
    chosen = tuning_of(cfg.train, fine=side > MAX_MUON_SIDE)
    optimizer = make_optimizer(model.parameters(), chosen, cfg.train.momentum)
    shown = (images("photo", batch, side) * 255).to(device, torch.uint8)
    labels = torch.arange(batch, device=device) % 16
    half = machine.precision(cfg.trainer.precision, cfg.trainer.accelerator) == "bf16-mixed"

    def once() -> None:
        with torch.autocast(device.type, torch.bfloat16, enabled=half):
            loss = model.training_step((shown, labels), 0)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    return once


def loading(settings: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a row for each size of files and each of `READ_SOURCES`: images per second, and those
    of clean training."""
    rows = []
    for side in settings["sides"]:
        model, batch, size = settings["models"][0 if side < 100 else -1]
        given = [
            "recipe=clean",
            f"model={model}",
            f"data.size={size}",
            "data=folder",
            f"train.batch_size={batch}",
        ]
        clean = step(configure(*given), batch, size)
        trained = batch / measure.timed(clean, settings["repeats"], settings["warmup"]).median
        with tempfile.TemporaryDirectory() as root:
            write_folder(Path(root), settings["files"], side)
            cfg = configure(*given, f"data.root={root}", "data.val=2")
            for source, workers in READ_SOURCES:
                loader = loader_of(cfg, source, workers)
                n = len(loader) * min(batch, settings["files"])
                taken = measure.timed(
                    lambda loader=loader: list(loader), 3 if settings["repeats"] > 1 else 1
                ).median
                rows.append(
                    {
                        "side": side,
                        "model": model,
                        "read_from": source,
                        "workers": workers,
                        "loaded": n / taken,
                        "trained": trained,
                        "share": trained / (n / taken),
                    }
                )
    return rows


def loader_of(cfg: Config, source: str, workers: int) -> DataLoader:
    """Return a loader of the training images that decodes their files in every pass, or, of the
    source "memory", in the first alone."""
    # images are kept in memory only where no workers are set
    data = replace(cfg.data, workers=0 if source == "memory" else max(1, workers))
    batches = Batches(load(data), cfg.train.batch_size, workers=workers, seed=cfg.seed)
    return batches.train_dataloader()


def write_folder(root: Path, n: int, side: int) -> None:
    """Write n + 4 JPEG files of a photograph, in train/ and test/."""
    shown = (images("photo", 4, side).movedim(1, -1) * 255).to(torch.uint8).numpy()
    for half, many in (("train", n + 2), ("test", 2)):
        (root / half / "a").mkdir(parents=True)
        for i in range(many):
            Image.fromarray(shown[i % 4]).save(root / half / "a" / f"{i}.jpg", quality=90)


if __name__ == "__main__":
    main()
