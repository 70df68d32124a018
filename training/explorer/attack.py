"""The ladder of one picture: a run's model on it when clean, photographed and attacked."""

import html
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from moireaug.evaluation.conditions import EvalBatch
from moireaug.evaluation.suites.ladder import ladder_conditions
from moireaug.evaluation.tables import SuiteConfig
from moireaug.scenes import Scene
from training.data import load as data
from training.explorer.photo import Picture, as_picture
from training.report.page import embedded_picture, title_of
from training.runs.trained import read

MAX_IMAGES = 24  # of a run's test images, to choose from


class OpenedRun(NamedTuple):
    """A trained model, and test images (N, 3, H, W) in [0, 1] with their labels (N,).

    Args:
        shrink: as of the run's settings: that of crops; None for whole photos.
    """

    name: str
    model: nn.Module
    images: Tensor
    labels: Tensor
    classes: dict[int, str]
    shrink: Any = None


class LadderRow(NamedTuple):
    """One row of the ladder: its picture, and the model's answer with its probability."""

    title: str
    picture: Picture
    answer: str
    probability: float
    right: bool

    @property
    def verdict(self) -> str:
        """Return "right" or "wrong"."""
        return "right" if self.right else "wrong"


def open_run(folder: str) -> OpenedRun:
    """Read a run's model, and the first of its test images."""
    if not folder.strip():
        raise ValueError("name the folder of a run, such as runs/moire_at/seed0.")
    trained = read(Path(folder.strip()))
    data_settings = replace(trained.cfg.data, train=1, val=1, test=MAX_IMAGES)
    splits = data.load(data_settings)
    trained.check_classes(splits, data_settings)
    pictures, labels = [], []
    for index in range(len(splits.test)):  # type: ignore[arg-type]
        picture, label = splits.test[index]
        pictures.append(picture)
        labels.append(int(label))
    images = torch.stack(pictures).float() / 255
    return OpenedRun(
        folder.strip(),
        trained.model(),
        images,
        torch.tensor(labels, device="cpu"),
        splits.classes,
        trained.cfg.shrink,
    )


def ladder(
    run: OpenedRun, index: int, scene: Scene, eps: float, steps: int, seed: int = 0
) -> list[LadderRow]:
    """Show a run's model one of its test images, row by row: each adds one thing.

    Args:
        scene: of whole photos; where the run is of crops, they are of its shrink.
        eps: bound of the noise, in [0, 1] units of codes.
        seed: seed of the shot and of the random rows.
    """
    if not 0 <= index < len(run.images):
        raise ValueError(f"image must be 0 to {len(run.images) - 1}; got {index}.")
    if run.shrink is not None:
        scene = scene.with_shrink(run.shrink)
    image, label = run.images[index : index + 1], run.labels[index : index + 1]
    size = (image.shape[-2], image.shape[-1])
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        order = run.model(image)[0].argsort(descending=True)
    likeliest = order[order != label[0]][:1]  # the likeliest wrong class
    batch = EvalBatch(
        run.model, image, label, likeliest, scene.sample(1, size, generator), generator
    )
    rows = []
    for condition in ladder_conditions(SuiteConfig(scene=scene, eps=(eps,), steps=steps)):
        photo = condition.show(batch).detach()
        with torch.no_grad():
            chances = run.model(photo)[0].softmax(0)
        answer = int(chances.argmax())
        class_name = run.classes.get(answer, str(answer))
        row = LadderRow(
            title_of(condition.name, "ladder"),
            as_picture(photo),
            class_name,
            float(chances[answer]),
            answer == int(label),
        )
        rows.append(row)
    return rows


def as_html(rows: Sequence[LadderRow]) -> str:
    """Return a ladder as HTML figures: each row's picture, and the model's answer below it."""
    figures = []
    for row in rows:
        picture = embedded_picture(row.picture, row.title)
        title, answer = html.escape(row.title), html.escape(row.answer)
        caption = f"{answer}, {row.probability:.0%}: {row.verdict}"
        figures.append(
            f'<figure><img src="{picture["uri"]}" alt="{title}">'
            f'<figcaption>{title}<br><span class="{row.verdict}">{caption}</span>'
            "</figcaption></figure>"
        )
    return f'<div class="rows">{"".join(figures)}</div>'
