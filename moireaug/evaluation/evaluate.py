"""Evaluate any classifier in one call."""

from __future__ import annotations

import dataclasses
import itertools
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from moireaug.attacks.bounds import BOUNDS
from moireaug.attacks.model import class_count
from moireaug.common.argument_checks import check_callable, check_whole, one_of
from moireaug.common.networks import device_of
from moireaug.defenses import Defence
from moireaug.evaluation.batches import Batch, collect_batches, restored_generators
from moireaug.evaluation.classifiers import UNDEFENDED, Classifier
from moireaug.evaluation.conditions import ImageTransform, Model
from moireaug.evaluation.frame import images_frame
from moireaug.evaluation.identity import identity_of, require_identity
from moireaug.evaluation.records import EvalSetup, Record, RecordFolder, Records
from moireaug.evaluation.runner import CLEAN, Runner, jobs_of, show_progress
from moireaug.evaluation.statistics import wilson
from moireaug.evaluation.suites import OPTION_SUITES, Suite, check_used, suite_name, tables_of
from moireaug.evaluation.tables import SuiteConfig, Table, paper_defences
from moireaug.evaluation.visibility import LPIPS
from moireaug.mixtures import SceneLike, as_scenes

# clean images: from how many a rate no greater than guessing's says something, and from how many
# an interval tells a model from guessing
N_TO_TELL_CHANCE = (20, 100)


def evaluate(
    model: Model,
    loader: Iterable[Batch],
    suite: str | Suite[SuiteConfig] = "ladder",
    scene: SceneLike = "screen_photo",
    *,
    eps: float | Sequence[float] | None = None,
    bound: str = "codes",
    steps: int = 20,
    n: int | None = None,
    seed: int = 0,
    targets: Mapping[str, Model] | None = None,
    defences: Mapping[str, ImageTransform] | None = None,
    folder: str | Path | None = None,
    identity: str | bytes | None = None,
    lpips: str | Path | None = None,
    progress: bool = True,
    shrink: float | tuple[float, float] | None = None,
) -> pd.DataFrame:
    """Attack a classifier, with controls that separate moiré from noise.

        frame = evaluation.evaluate(model, loader, suite="ladder", scene="screen_photo", n=480)
        print(evaluation.rates(frame))

    Args:
        model: any callable of [0, 1] images (B, 3, H, W) that returns logits (B, K); its state is
            restored. Put a normalisation inside: `attacks.Normalized(model, mean, std)`.
        loader: batches of (images, labels), as a DataLoader yields them; uint8 images are divided
            by 255. Its first n images are held in memory. Its order must not change where `folder`
            is given.
        suite: a key of `evaluation.SUITES`, or of `evaluation.GROUPS`; or a function of an
            `evaluation.SuiteConfig` that returns an `evaluation.Table`, or a list of them.
        scene: a Scene, a preset's name or a dict, or a list of these, a mixture: each image is then
            photographed in one of them. There is one photo per image, the same for all conditions.
        eps: bounds of the noise, in [0, 1] units: ladder, full_ladder and standard attack at each,
            the others at the middle one, of two at the greater. None is 2, 4 and 8/255, or 4 and
            8/255 for standard. worst_case always has these two; unseen attacks nothing.
        bound: scale of eps on a raw image: "codes" (sRGB) or "light", as of `attacks.MoireAttack`.
            On pixels, eps is always sRGB.
        steps: gradient steps of every attack.
        n: number of images; None is all.
        seed: seed of the photos, targets and random starts.
        targets: name to model, for the suite "trust".
        defences: name to defence, in addition to the paper's, or replacing the one of that name:
            adaptive has a row for every new name, but not for each of the paper's.
        folder: where results are saved incrementally; the same call resumes. None keeps them in
            memory. They are identified by pixels, weights and settings: model, targets, defences,
            and what your own conditions hold, must be Modules, defences of `defenses` or plain; any
            other callable needs an attribute `identity`, a text to change whenever its answers
            change.
        identity: such a text for the model, in addition to its weights.
        lpips: a file with the state_dict of torchvision's squeezenet1_1, alexnet or vgg16, with
            which the LPIPS of every attack is measured; None does not measure it.
        progress: whether to show a bar.
        shrink: images are crops, parts of larger photos, in every scene of the suite; see
            `Scene.with_shrink`.

    Warns if the model is no better than chance on clean images: it may take normalised ones.

    Returns:
        A row for each cell of the suite's tables and each image: see `evaluation.images_frame`.
        `evaluation.rates` turns it into a row per cell, with intervals.

    Raises:
        ValueError, TypeError: an unknown suite, or an option that it has no use for; no images;
            images, labels or logits of a wrong type or shape; a defence that the suite has no row
            for; a part on another device than the model; a folder with a callable without an
            identity; an lpips file of another network.
    """
    _check_parts(model, targets=targets, defences=defences)
    if eps is not None:
        eps = tuple(np.atleast_1d(eps).tolist())
    one_of("bound", bound, BOUNDS)
    check_whole("steps", steps, 0)
    check_whole("seed", seed, 0)
    steps, seed = int(steps), int(seed)  # NumPy's have no place in records
    config = SuiteConfig(
        scene=as_scenes(scene),
        shrink=shrink,
        eps=eps,
        steps=steps,
        targets=targets or {},
        defences=paper_defences() | dict(defences or {}),
    )
    tables = tables_of(suite, config)
    options = {"eps": eps, "targets": targets, "defences": defences, "lpips": lpips}
    for option, given in options.items():
        if given and isinstance(suite, str):
            check_used(suite, option, OPTION_SUITES[option])
    _check_defence_names(suite_name(suite), tables, config, defences or {})
    if folder is not None:
        _require_identities(model, identity, tables)
    lpips_network = None if lpips is None else LPIPS(lpips)
    batches = collect_batches(loader, n)  # which may take long, so after all settings
    if lpips_network is not None:
        lpips_network.require_side(min(min(images.shape[-2:]) for images, _ in batches))
    labels = torch.cat([labels for _, labels in batches])
    images = batches[0][0].to(device_of(model))
    with restored_generators():  # before its identity holds on to its buffers
        n_classes = class_count(model, images, labels)
    records = Records() if folder is None else RecordFolder(Path(folder))
    setup = EvalSetup(config.scene, seed, bound, lpips_network)
    runner = Runner(model, batches, setup, records, identity_of(model, identity))
    jobs = jobs_of(tables)
    indices = range(len(batches))
    finished_jobs = runner.run(jobs, indices)
    clean_records: list[Record] = []
    is_told = False
    total = len(jobs) * len(batches)
    for job in show_progress(finished_jobs, total, suite_name(suite), enabled=progress):
        if job.condition is CLEAN and not is_told:
            clean_records.append(runner.record(CLEAN, UNDEFENDED, len(clean_records)))
            is_told = _warn_of_chance(clean_records, n_classes)
    return images_frame(tables, runner, indices)


def _warn_of_chance(records: Sequence[Record], n_classes: int) -> bool:
    """Warn of a model that gets no more of the clean images right than guessing would; return
    whether the images are enough to tell."""
    predicted = np.concatenate([record["predicted"] for record in records])
    labels = np.concatenate([record["labels"] for record in records])
    n, n_right = len(labels), int((predicted == labels).sum())
    few, many = N_TO_TELL_CHANCE
    rate = wilson(n_right, n)[0] if n >= many else n_right / max(1, n)
    is_chance = n >= few and rate <= 1 / n_classes
    if is_chance:
        warnings.warn(
            f"the model gets {n_right} of {n} clean images right, as guessing among {n_classes} "
            "classes does. It is given images in [0, 1]: if it was trained on normalised ones, "
            "pass attacks.Normalized(model, mean, std).",
            stacklevel=3,
        )
    return is_chance or n >= many


def _check_parts(model: Model, **options: Mapping[str, Model] | None) -> None:
    """Refuse a model, targets and defences that cannot be called, and those on another device than
    the model: TypeError or ValueError."""
    check_callable("model", model)
    device = device_of(model)
    for option, parts in options.items():
        if parts is not None and not isinstance(parts, Mapping):
            raise TypeError(f"{option} must be a dict, by name; got {parts!r}.")
        for name, part in (parts or {}).items():
            check_callable(name, part, "images" if option == "defences" else "logits (B, K)")
            for network in part.networks if isinstance(part, Defence) else (part,):
                other = device_of(network)
                if None not in (device, other) and other != device:
                    raise ValueError(
                        f"{name} is on {other}, the model on {device}: pass "
                        f"{name}.to({str(device)!r})."
                    )


def _check_defence_names(
    suite: str, tables: Sequence[Table], config: SuiteConfig, names: Iterable[str]
) -> None:
    """Refuse the name of a defence that stands in no table: ValueError."""
    shown = {id(cell.classifier.defence) for table in tables for cell in table.cells}
    known = [name for name, defence in config.defences.items() if id(defence) in shown]
    advice = "Use one of these names, or suite=adaptive."
    if suite == "adaptive":
        advice = "Give yours another name, and it gets a row."
    for name in names:
        if name not in known:
            raise ValueError(
                f"suite={suite} has no row for a defence {name!r}, but for {', '.join(known)}. "
                f"{advice}"
            )


def _require_identities(model: Model, stated: str | bytes | None, tables: Sequence[Table]) -> None:
    """Refuse parts of an evaluation that a later one could not identify."""
    if stated is None:
        require_identity("the model", model)
    elif not isinstance(stated, (str, bytes)) or not stated:
        raise TypeError(f"identity must be a text that identifies the model; got {stated!r}.")
    parts = {id(part): (name, part) for name, part in _parts_of(tables)}
    for name, part in parts.values():  # each once: weights take long
        require_identity(name, part)


def _parts_of(tables: Sequence[Table]) -> Iterator[tuple[str, object]]:
    """Yield what classifiers and conditions hold, each with a name."""
    for cell in itertools.chain.from_iterable(table.cells for table in tables):
        classifiers = [cell.classifier]
        for condition in cell.conditions:
            for field in dataclasses.fields(condition):
                value = getattr(condition, field.name)
                if isinstance(value, Classifier):
                    classifiers.append(value)
                elif field.name != "scene":
                    yield f"{field.name} of {condition.name}", value
        for classifier in classifiers:
            yield classifier.name, classifier.defence
            yield classifier.name, classifier.model
