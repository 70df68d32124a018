"""Catastrophic overfitting: what counts as a collapse, and what becomes of a model that has
collapsed."""

import lightning as L
import pytest
import torch
from torch import nn

from tests.training.small import TINY, configured
from training.classifier import guard
from training.classifier.module import Classifier, has_collapsed
from training.classifier.train import classifier_of
from training.config.schema import Config
from training.data.batches import Batches
from training.models.classifiers import as_model

pytestmark = pytest.mark.usefixtures("as_the_command_is")


@pytest.mark.parametrize(
    ("accuracies", "fallen"),
    [
        ([0.5], False),
        ([0.5, 0.45], False),
        ([0.5, 0.45, 0.1], True),
        ([0.15, 0.01], False),
        ([0.6, 0.2, 0.5], False),
    ],
)
def test_what_counts_as_a_collapse(accuracies, fallen):
    assert has_collapsed(accuracies) == fallen


class Steps(L.Callback):
    """Keeps the attack's steps in every epoch, and the weights that each began with."""

    def __init__(self):
        self.weights, self.steps = {}, {}

    def on_train_epoch_start(self, trainer, module):
        self.weights[trainer.current_epoch] = {k: v.clone() for k, v in module.state_dict().items()}
        self.steps[trainer.current_epoch] = module.adversary.cfg.steps


STEADY = [(0.5, 0.3), (0.5, 0.3), (0.5, 0.3)]  # accuracy on clean and attacked images, by epoch
# better in the mean of both
COLLAPSE = [(0.5, 0.3), (0.9, 0.1), (0.4, 0.3)]
LATE_COLLAPSE = [(0.4, 0.3), (0.5, 0.3), (0.9, 0.1)]
ONE_STEP = ["adversary.steps=1"]


def trained(tmp_path, monkeypatch, accuracies, *overrides):
    """Train for three epochs with these accuracies in validation."""
    from lightning.pytorch.callbacks import EMAWeightAveraging, ModelCheckpoint

    from training.data.load import load

    def validated(self, batch, index):
        for name, accuracy in zip(self._hits, accuracies[self.current_epoch], strict=True):
            self._hits[name].append(torch.tensor([accuracy]))

    monkeypatch.setattr(Classifier, "validation_step", validated)
    cfg = configured(
        "recipe=moire_at", *TINY, *ONE_STEP, "train.init=random", "train.epochs=3", *overrides
    )
    L.seed_everything(0, verbose=False)
    model, seen = classifier_of(cfg, 16), Steps()
    best = ModelCheckpoint(
        tmp_path, "best", monitor="val_score", mode="max", enable_version_counter=False
    )
    trainer = L.Trainer(
        max_epochs=3,
        accelerator="cpu",
        logger=False,
        num_sanity_val_steps=0,
        use_distributed_sampler=False,
        callbacks=[EMAWeightAveraging(decay=0.5), best, guard.Guard(tmp_path / "best.ckpt"), seen],
        enable_model_summary=False,
        enable_progress_bar=False,
    )
    trainer.fit(model, Batches(load(cfg.data), cfg.train.batch_size, workers=0, seed=cfg.seed))
    return model, seen, torch.load(tmp_path / "best.ckpt", weights_only=True)


def test_a_collapsed_model_returns_to_its_best_epoch(tmp_path, monkeypatch, capsys):
    model, seen, best = trained(tmp_path, monkeypatch, COLLAPSE)
    assert best["epoch"] == 0
    assert model.collapsed_at == 1 and seen.steps == {0: 1, 1: 1, 2: 3}
    assert "Back to epoch 1, and training continues with three steps" in capsys.readouterr().out
    again, before = seen.weights[2], best["current_model_state"]
    assert all(torch.equal(again[k], before[k]) for k in before)
    # the collapse outlives the process
    kept: dict = {}
    model.on_save_checkpoint(kept)
    resumed = classifier_of(configured("recipe=moire_at", *TINY, *ONE_STEP), 16)
    resumed.on_load_checkpoint(kept)
    assert resumed.is_hardened and resumed.adversary.cfg.steps == 3


def test_a_collapse_in_the_last_epoch_is_recorded_alone(tmp_path, monkeypatch, capsys):
    model, seen, best = trained(tmp_path, monkeypatch, LATE_COLLAPSE)
    assert best["epoch"] == 1 and model.collapsed_at == 2 and seen.steps[2] == 1
    assert "It was the last epoch: an earlier one is kept" in capsys.readouterr().out


def test_multi_step_training_is_left_alone(tmp_path, monkeypatch):
    model, seen, best = trained(tmp_path, monkeypatch, COLLAPSE, "adversary.steps=3")
    assert model.collapsed_at is None and seen.steps[2] == 3 and best["epoch"] == 1


def test_training_without_momentum_trains(tmp_path, monkeypatch):
    model, _, _ = trained(tmp_path, monkeypatch, STEADY, "train.momentum=0")
    assert len(model.history) == 3


@pytest.mark.parametrize(("given", "moves"), [(None, False), (True, True)])
def test_fine_tuning_keeps_the_weights_own_statistics(given, moves, tmp_path, monkeypatch):
    path = tmp_path / "weights.pt"
    torch.save(as_model(Config.model, 16).state_dict(), path)
    setting = f"train.batch_statistics={given or 'null'}"
    model, _, _ = trained(tmp_path, monkeypatch, STEADY, f"weights={path}", setting)
    statistics = {k: v for k, v in model.model.state_dict().items() if "running" in k}
    assert (
        statistics and any((v != float("var" in k)).any() for k, v in statistics.items()) == moves
    )
    model.train()
    assert any(m.training for m in model.modules() if isinstance(m, nn.BatchNorm2d)) == moves
