"""Fine-tuning: defaults under which any classifier learns from given weights, at any batch, in few
steps."""

import pytest
import torch
import torch.nn.functional as F
from torch.utils.data import TensorDataset

from tests.training.small import configured
from training.classifier.module import Classifier
from training.classifier.train import classifier_of, train_model
from training.classifier.tuning import Tuning, tuning_of, weight_averaging
from training.config.schema import Train
from training.data.splits import Splits
from training.models import classifiers as models
from training.runs.run import Run
from training.system.files import read_checkpoint

pytestmark = pytest.mark.usefixtures("as_the_command_is")


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ((), Tuning(False, 0.02, 0.05, None, 0.98, False)),
        (("train.lr=0.05", "train.ema=0.9"), Tuning(False, 0.05, 0.05, None, 0.9, False)),
        (("train.weight_decay=0",), Tuning(False, 0.02, 0, None, 0.98, False)),
        (("weights=x",), Tuning(True, 0.001, 5e-4, 1.0, 0.98, True)),
        (("weights=x", "train.batch_size=128"), Tuning(True, 0.002, 5e-4, 1.0, 0.98, True)),
        (("weights=x", "train.batch_size=8"), Tuning(True, 0.000125, 5e-4, 1.0, 0.98, True)),
        (("weights=x", "train.lr=0.01", "train.ema=0"), Tuning(True, 0.01, 5e-4, 1.0, 0, False)),
    ],
)
def test_null_is_chosen_and_what_is_given_stays(given, expected):
    cfg = configured(*given)
    assert tuning_of(cfg.train, fine=cfg.weights is not None) == expected


def test_a_rising_average_ends_at_its_decay():
    average = weight_averaging(tuning_of(Train(), fine=True))._kwargs["avg_fn"]
    old, new = torch.tensor(1.0), torch.tensor(0.0)
    kept = [average(old, new, torch.tensor(n)).item() for n in (1, 4, 40, 10_000)]
    assert kept == pytest.approx([2 / 11, 5 / 14, 41 / 50, 0.98])


def learnt(n, size):
    """Two classes of images: which half is brighter."""
    g = torch.Generator().manual_seed(n)
    labels = torch.arange(n) % 2
    images = torch.randint(0, 120, (n, 3, size, size), generator=g, dtype=torch.uint8)
    images[labels == 1, :, :, : size // 2] += 100
    images[labels == 0, :, :, size // 2 :] += 100
    return TensorDataset(images, labels)


def loss_of(model, data):
    images, labels = data.tensors
    model.eval()
    with torch.no_grad():
        return F.cross_entropy(model(images.float() / 255), labels).item()


def tuned(tmp_path, name, batch, size, *more):
    """Losses before and after a few steps from saved weights, and the run's history."""
    torch.manual_seed(0)
    torch.save(models.as_model(name, 2).state_dict(), tmp_path / "weights.pth")
    cfg = configured(
        "recipe=clean",
        f"model={name}",
        f"weights={tmp_path / 'weights.pth'}",
        f"data.size={size}",
        f"train.batch_size={batch}",
        "train.epochs=2",
        "trainer.accelerator=cpu",
        f"runs={tmp_path / 'runs'}",
        *more,
    )
    data = learnt(16, size)
    before = loss_of(classifier_of(cfg, 2), data)
    Run(cfg).prepare()
    model, _ = train_model(Run(cfg), Splits(data, data, data, {}, 2))
    last = classifier_of(cfg, 2)
    last.load_state_dict(read_checkpoint(Run(cfg).folder / "last.ckpt")["state_dict"])
    return before, loss_of(last, data), model.history


@pytest.mark.parametrize(
    ("name", "batch", "size"),
    [("shufflenet_v2_x0_5", 8, 32), ("small_resnet", 16, 24)],
)
def test_a_network_is_not_worse_after_a_few_steps(name, batch, size, tmp_path):
    before, after, history = tuned(tmp_path, name, batch, size)
    assert all(torch.tensor(h["loss"]).isfinite() for h in history)
    assert after <= before * 1.02, (before, after)


def test_gradients_are_clipped_in_fine_tuning_alone(tmp_path, monkeypatch):
    seen = []

    def clip(self, optimizer, gradient_clip_val=None, gradient_clip_algorithm=None):
        seen.append(gradient_clip_val)

    monkeypatch.setattr(Classifier, "clip_gradients", clip)
    tuned(tmp_path, "small_resnet", 8, 24)
    assert set(seen) == {1.0}
    seen.clear()
    tuned(tmp_path, "small_resnet", 8, 24, "weights=null")
    assert set(seen) == {None}
