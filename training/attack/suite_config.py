"""The configuration of a re-attack's suite, with the models and defences that its settings name."""

from __future__ import annotations

import dataclasses
import os
import pkgutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import nn
from torch.utils.data import Subset

from moireaug.defenses import Quilting, demoire
from moireaug.defenses.demoire import Demoire
from moireaug.evaluation.conditions import ImageTransform
from moireaug.evaluation.identity import require_identity
from training.attack.subject import Subject
from training.config.data_sets import Data
from training.config.schema import ReattackConfig
from training.data.splits import Splits
from training.models.classifiers import as_model, model_names
from training.runs.identity import fingerprint_of
from training.runs.layout import BEST, NETWORK
from training.runs.run import Run
from training.runs.trained import read
from training.suites import OPTION_SUITES
from training.suites.config import PaperConfig

if TYPE_CHECKING:
    from lightning import Fabric

PAPER_TARGETS = ("resnet50", "resnet34", "densenet121", "vgg16", "vgg19")
# of image quilting: patches of its bank, and images that they are drawn from
BANK_PATCHES, MAX_DONOR_IMAGES = 50_000, 500


def suite_config(cfg: ReattackConfig, subject: Subject, fabric: Fabric) -> PaperConfig:
    """Return the configuration of the suite that these settings name."""
    splits, protocol = subject.splits, subject.protocol
    targets: Mapping[str, nn.Module | None] = {}
    if cfg.suite in OPTION_SUITES["targets"]:
        targets = targets_of(cfg.targets, cfg.data, splits, fabric.device)
    config = dataclasses.replace(protocol.config(), targets=targets)
    defences = dict(config.defences)
    without = {}
    networks: dict[str, ImageTransform] = {}
    if cfg.networks:  # before a patch bank is made
        networks = networks_of(cfg.networks, fabric.device)
    if cfg.demoire:
        given_defence = Demoire(callable_of(cfg.demoire, fabric.device))
        (networks if cfg.suite == "demoireing" else defences)[cfg.demoire] = given_defence
    if cfg.suite == "demoireing" and not networks:
        raise ValueError(
            "suite=demoireing needs demoiréing networks: pass networks=DIR with their weights, or "
            "demoire=package.module:callable."
        )
    if cfg.suite in ("defences", "paper"):
        donors = protocol.batches.unattacked_images(splits)
        if len(donors):
            data = fingerprint_of(Run(cfg).settings["data"])
            cache = subject.records / f"quilting-{data}.npz"
            with fabric.rank_zero_first():  # the others read the bank that it makes
                defences["quilting"] = quilting(donors, cache)
        else:
            without["quilting"] = "there are no images for its patch bank besides those attacked"
    return dataclasses.replace(config, defences=defences, networks=networks, without=without)


def targets_of(
    targets: Any, data: Data, splits: Splits, device: torch.device
) -> dict[str, nn.Module | None]:
    """Return the models that attacks transfer to, by name.

    Those are the given ones, by a file of weights or a run's folder; and with `class_index` the
    paper's, None where no weights are given."""
    if targets is not None and not isinstance(targets, Mapping):
        raise ValueError(
            f"targets={targets!r} must be names with weights, as in targets='{{resnet18: FILE}}'."
        )
    models: dict[str, nn.Module | None] = {}
    for name, weights in (targets or {}).items():
        if isinstance(weights, str) and (Path(weights) / BEST).is_file():
            run = read(Path(weights))
            run.check_classes(splits, data)
            models[name] = run.model().to(device)
        elif name in model_names():
            models[name] = None
            if weights:
                model = as_model(name, splits.num_classes, weights, whole=True)
                models[name] = model.to(device).eval()
        else:
            raise ValueError(
                f"targets.{name}={weights!r} is neither a run's folder with best.ckpt nor a "
                "model's name with weights. Pass targets='{NAME: DIR}', or "
                "targets='{resnet18: FILE}'."
            )
    if data.class_index:
        for name in PAPER_TARGETS:
            models.setdefault(name, None)
    return models


def quilting(images: Subset, cache: Path) -> Quilting:
    """Return an image quilting with patches from these images; its bank is cached in a file."""
    stack = []
    for i in range(min(len(images), MAX_DONOR_IMAGES)):
        stack.append(images[i][0])
    pixels = torch.stack(stack).float() / 255
    cache.parent.mkdir(parents=True, exist_ok=True)
    return Quilting.from_images(pixels, patches=BANK_PATCHES, seed=0, cache=cache)


def networks_of(networks: Any, device: torch.device) -> dict[str, ImageTransform]:
    """Return demoiréing networks by name.

    Args:
        networks: folder of files FILE.pt, which name the networks; or a file of weights or a run's
            folder by name.
    """
    places = networks
    if isinstance(networks, str):
        places = {file.stem: file for file in sorted(Path(networks).glob("*.pt"))}
    if not isinstance(places, Mapping) or not places:
        raise ValueError(
            f"networks={networks!r} has no weights of demoiréing networks. Pass a folder with "
            "files of demoire.save, such as mopnet.pt, or networks='{mopnet: FILE}'."
        )
    defences: dict[str, ImageTransform] = {}
    for name, place in places.items():
        file = Path(place) / NETWORK if Path(place).is_dir() else Path(place)
        network = demoire.load(file)
        if name == Path(NETWORK).stem:  # of a run's own folder
            name = network.name
        if name in demoire.NETWORKS and name != network.name:
            raise ValueError(
                f"networks: {name!r} names another network than {str(file)!r} holds, "
                f"{network.name}: its row would show that network's published figures. Rename it."
            )
        defences[name] = Demoire(network.to(device))
    return defences


def callable_of(name: str, device: torch.device) -> ImageTransform:
    """Import the callable `package.module:name`, as `python -c` in the working folder would.

    The working folder stays the first that is searched: a function may import more once it is
    called."""
    working_folder = os.getcwd()
    if sys.path[0] != working_folder:
        sys.path.insert(0, working_folder)
    try:
        defence = pkgutil.resolve_name(name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(
            f"demoire={name!r} could not be imported ({error}): {working_folder!r} was searched, "
            "then PYTHONPATH and the installed packages. Pass package.module:callable."
        ) from error
    if not callable(defence) or isinstance(defence, type):
        raise ValueError(
            f"demoire={name!r} is a {type(defence).__name__}, not a callable on (B, 3, H, W) in "
            "[0, 1]."
        )
    try:
        require_identity(name, defence)
    except ValueError as error:
        raise ValueError(
            f"demoire={name!r} is or holds a function. Changes of its code are not seen, and "
            "results of the old code would be reused. State its version, and change it with the "
            f"code: {name.rpartition(':')[2]}.identity = 'first'."
        ) from error
    return defence.eval().to(device) if isinstance(defence, nn.Module) else defence
