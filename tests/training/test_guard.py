"""Catastrophic overfitting: what counts as a collapse, and what becomes of a model that has
collapsed."""

from pathlib import Path

import lightning as L
import pytest
import torch
from lightning.pytorch.callbacks import EMAWeightAveraging, ModelCheckpoint
from torch import nn

from tests.training.small import TINY, configured, same, train
from training.classifier import guard
from training.classifier.module import Classifier, has_fallen
from training.classifier.train import classifier_of
from training.config.schema import PHOTO_ATTACKS, Config
from training.data.batches import Batches
from training.data.load import load
from training.models.classifiers import as_model
from training.runs.run import Run
from training.trainer.make import AtomicCheckpointIO, EpochLines

pytestmark = pytest.mark.usefixtures("as_the_command_is")


def test_what_counts_as_a_collapse():
    assert has_fallen([0.5, 0.45, 0.1])
    for steady in ([0.5], [0.5, 0.45], [0.15, 0.01], [0.6, 0.2, 0.5]):
        assert not has_fallen(steady), steady


class Steps(L.Callback):
    """Keeps the attack's steps in every epoch, and the weights that each began with."""

    def __init__(self):
        self.weights, self.steps = {}, {}

    def on_train_epoch_start(self, trainer, module):
        self.weights[trainer.current_epoch] = {k: v.clone() for k, v in module.state_dict().items()}
        self.steps[trainer.current_epoch] = module.adversary.cfg.steps


# accuracy on clean and attacked images and, where given, on photos without an attack, by epoch
STEADY = [(0.5, 0.3), (0.5, 0.3), (0.5, 0.3)]
# better in the mean of both
COLLAPSE = [(0.5, 0.3), (0.9, 0.1), (0.4, 0.3)]
RECOVERY = [*COLLAPSE[:2], (0.6, 0.5)]
MASKED = [(0.5, 0.3), (0.7, 0.9), (0.4, 0.3)]  # no attack makes images easier
EASY_PHOTOS = [(0.3, 0.4, 0.5), (0.4, 0.5, 0.6), (0.5, 0.6, 0.7)]
LATE_COLLAPSE = [(0.4, 0.3), (0.5, 0.3), (0.9, 0.1)]
ONE_STEP = ["adversary.steps=1"]


GIVEN = ["recipe=moire_at", *TINY, *ONE_STEP, "data.train=16", "train.init=random"]


def validate_with(monkeypatch, accuracies):
    """Have validation find these accuracies, by epoch."""

    def validated(self, batch, index):
        for name, accuracy in zip(self.figures, accuracies[self.current_epoch], strict=False):
            self.figures[name].append(torch.tensor([accuracy]))

    monkeypatch.setattr(Classifier, "validation_step", validated)


def trained(tmp_path, monkeypatch, accuracies, *overrides):
    """Train for three epochs with these accuracies in validation."""
    validate_with(monkeypatch, accuracies)
    cfg = configured(*GIVEN, *overrides)
    L.seed_everything(0, verbose=False)
    model, seen = classifier_of(cfg, 16), Steps()
    best = ModelCheckpoint(
        tmp_path, "best", monitor="val_score", mode="max", enable_version_counter=False
    )
    undo = guard.CollapseGuard(tmp_path / "best.ckpt")
    quiet = dict.fromkeys(("logger", "enable_model_summary", "enable_progress_bar"), False)
    trainer = L.Trainer(
        max_epochs=3,
        accelerator="cpu",
        num_sanity_val_steps=0,
        use_distributed_sampler=False,
        callbacks=[EMAWeightAveraging(decay=0.5), best, undo, seen],
        **quiet,
    )
    trainer.fit(model, Batches(load(cfg.data), cfg.train.batch_size, workers=0, seed=cfg.seed))
    kept = torch.load(tmp_path / "best.ckpt", weights_only=True)
    guard.note_late_collapse(model, kept["epoch"])
    return model, seen, kept


def test_a_collapsed_model_returns_to_its_best_epoch(tmp_path, monkeypatch, capsys):
    model, seen, best = trained(tmp_path, monkeypatch, COLLAPSE)
    assert best["epoch"] == 0
    assert model.collapsed_at == 1 and seen.steps == {0: 1, 1: 1, 2: 3}
    assert "Back to epoch 1, and training continues with 3 steps" in capsys.readouterr().out
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
    assert "It was the last epoch: epoch 2 is kept" in capsys.readouterr().out


def before_the_last_checkpoint(patch):
    """Stop when the third epoch's best.ckpt is written, and its last.ckpt is not."""
    save = AtomicCheckpointIO.save_checkpoint

    def stop(self, checkpoint, path, storage_options=None):
        if checkpoint["epoch"] == 2 and Path(path).name == "last.ckpt":
            raise KeyboardInterrupt
        save(self, checkpoint, path)

    patch.setattr(AtomicCheckpointIO, "save_checkpoint", stop)


def after_the_last_checkpoint(patch):
    """Stop when the third epoch is kept, and the cost of the training is not."""

    def stop(self, trainer, module):
        if trainer.current_epoch == 2:
            raise KeyboardInterrupt

    patch.setattr(EpochLines, "on_train_epoch_end", stop)


@pytest.mark.parametrize(
    ("accuracies", "stop_in", "kept", "passes"),
    [
        (RECOVERY, before_the_last_checkpoint, 2, 1 + 0.625 * (1 + 1 + 3) / 3),
        (LATE_COLLAPSE, after_the_last_checkpoint, 1, 1 + 0.625),
    ],
)
def test_a_run_that_was_stopped_after_its_collapse_resumes_to_the_same(
    accuracies, stop_in, kept, passes, tmp_path, monkeypatch, capsys
):
    validate_with(monkeypatch, accuracies)
    straight, stopped = (
        configured(*GIVEN, "train.epochs=3", f"runs={tmp_path / name}") for name in "ab"
    )
    whole, cost = train(straight)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        stop_in(patch)
        train(stopped)
    assert Run(stopped).stage() == "begun"
    run, resumed_cost = train(stopped)
    for one in (cost, resumed_cost):
        assert (one.collapsed_at, one.best_epoch) == (3 - kept, kept)
        assert one.passes == pytest.approx(passes)
    assert same(run.folder, whole.folder)
    assert capsys.readouterr().out.count("Catastrophic overfitting in epoch") == 2


def test_multi_step_training_is_left_alone(tmp_path, monkeypatch):
    model, seen, best = trained(tmp_path, monkeypatch, COLLAPSE, "adversary.steps=3")
    assert model.collapsed_at is None and seen.steps[2] == 3 and best["epoch"] == 1


@pytest.mark.parametrize(("steps", "more"), [(1, 3), (2, 3), (3, 6)])
def test_an_attack_that_shows_the_label_is_given_more_steps(
    steps, more, tmp_path, monkeypatch, capsys
):
    """Its epoch would be kept: it has by far the best score."""
    model, seen, best = trained(tmp_path, monkeypatch, MASKED, f"adversary.steps={steps}")
    assert model.collapsed_at == 1 and seen.steps == {0: steps, 1: steps, 2: more}
    assert best["epoch"] == 0
    said = "90% of attacked images are right, and of others only 70%. Back to epoch 1"
    assert said in capsys.readouterr().out


def test_a_model_masked_to_the_end_keeps_an_earlier_epoch(tmp_path, monkeypatch):
    """Also where more steps did not help. The first such epoch, as measured, looks merely good."""
    _, _, best = trained(tmp_path, monkeypatch, [MASKED[0], (0.66, 0.73), MASKED[1]])
    assert best["epoch"] == 0


def test_photos_without_an_attack_may_be_easier_than_clean_images(tmp_path, monkeypatch):
    model, _, best = trained(tmp_path, monkeypatch, MASKED, "recipe=moire_aug")
    assert model.collapsed_at is None and best["epoch"] == 1


def test_attacked_photos_may_be_easier_than_clean_images(tmp_path, monkeypatch):
    """Where all of training is photographed, in a scene far from clean, and the noise is faint."""
    model, _, best = trained(tmp_path, monkeypatch, EASY_PHOTOS)
    assert model.collapsed_at is None and best["epoch"] == 2


@pytest.mark.parametrize("kind", [*PHOTO_ATTACKS, "pgd"])
def test_a_validation_has_photos_without_an_attack_where_attacks_leave_photos(kind):
    model = classifier_of(configured(*GIVEN, f"adversary.kind={kind}"), 16).eval()
    asked, answered = [], model.model.forward
    model.model.forward = lambda images: asked.append(images.detach()) or answered(images)
    images, labels = torch.randint(256, (4, 3, 24, 24), dtype=torch.uint8), torch.arange(4)
    torch.manual_seed(0)
    expected = model.validation_adversary.photograph(images / 255)
    torch.manual_seed(0)
    attacked = model.validation_adversary(images / 255, labels)
    asked.clear()
    torch.manual_seed(0)
    model.validation_step((images, labels), 0)
    assert torch.equal(asked[-1], attacked)
    assert list(model.figures) == ["clean", "perturbed", *(["photo"] if kind != "pgd" else [])]
    assert torch.equal(asked[1], expected) == (kind != "pgd")


@pytest.mark.parametrize("moves", [False, True])
def test_fine_tuning_keeps_the_weights_own_statistics(moves, tmp_path, monkeypatch):
    """Without momentum, which trains as well."""
    path = tmp_path / "weights.pt"
    torch.save(as_model(Config.model, 16).state_dict(), path)
    given = [f"train.batch_statistics={moves or 'null'}", "train.momentum=0"]
    model, _, _ = trained(tmp_path, monkeypatch, STEADY, f"weights={path}", *given)
    assert len(model.history) == 3
    statistics = {k: v for k, v in model.model.state_dict().items() if "running" in k}
    assert statistics
    assert any((v != float("var" in k)).any() for k, v in statistics.items()) == moves
    model.train()
    assert any(m.training for m in model.modules() if isinstance(m, nn.BatchNorm2d)) == moves
