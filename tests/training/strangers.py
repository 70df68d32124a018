"""A run's folder as fit.py leaves it, made without training."""

from dataclasses import asdict

import torch
from omegaconf import OmegaConf

from tests.training.small import TINY, configured
from training import reattack
from training.data import signs
from training.models import classifiers as models
from training.runs.run import Run


def put(root, *overrides, classes=signs.CLASSES, edit=None):
    """Write a run of random weights.

    Args:
        classes: of the model. edit: changes the settings' text.
    """
    cfg = configured("recipe=clean", *TINY, f"runs={root}", *overrides)
    folder = Run(cfg).folder
    folder.mkdir(parents=True)
    text = OmegaConf.to_yaml(OmegaConf.create(asdict(cfg)))
    (folder / "config.yaml").write_text(edit(text) if edit else text)
    torch.manual_seed(0)
    state = models.as_model(cfg.model, len(classes)).state_dict()
    checkpoint = {
        "state_dict": {f"model.{name}": value for name, value in state.items()},
        "epoch": 1,
    }
    torch.save(checkpoint | {"classes": dict(enumerate(classes))}, folder / "best.ckpt")
    return folder


def images(root, *classes):
    """Write a folder of two grey pictures a class."""
    from torchvision.io import write_png

    for half in ("train", "test"):
        for name in classes:
            path = root / half / name
            path.mkdir(parents=True)
            for k in range(2):
                write_png(
                    torch.full((3, 24, 24), 60 * k, dtype=torch.uint8), str(path / f"{k}.png")
                )
    return root


def attack(folder, *given):
    """Attack a run as the command does."""
    given = [f"run={folder}", "trainer.accelerator=cpu", *given]
    return reattack.reattack(configured(*given, name="reattack"), given)
