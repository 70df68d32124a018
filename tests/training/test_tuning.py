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


def test_null_is_chosen_and_what_is_given_stays():
    for given, weights, expected in (
        ({}, False, Tuning(False, 0.02, 0.05, None, 0.98, False)),
        ({"lr": 0.05, "ema": 0.9}, False, Tuning(False, 0.05, 0.05, None, 0.9, False)),
        ({"weight_decay": 0.0}, False, Tuning(False, 0.02, 0, None, 0.98, False)),
        ({}, True, Tuning(True, 0.001, 5e-4, 1.0, 0.98, True)),
        ({"batch_size": 128}, True, Tuning(True, 0.002, 5e-4, 1.0, 0.98, True)),
        ({"batch_size": 8}, True, Tuning(True, 0.000125, 5e-4, 1.0, 0.98, True)),
        ({"lr": 0.01, "ema": 0.0}, True, Tuning(True, 0.01, 5e-4, 1.0, 0, False)),
    ):
        assert tuning_of(Train(**given), fine=weights) == expected


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


def tuned(tmp_path, name, size, *more):
    """Losses before and after a few steps from saved weights."""
    torch.manual_seed(0)
    torch.save(models.as_model(name, 2).state_dict(), tmp_path / "weights.pth")
    given = ["recipe=clean", f"model={name}", f"weights={tmp_path / 'weights.pth'}"]
    given += [f"data.size={size}", "train.batch_size=8", "train.epochs=2"]
    cfg = configured(*given, "trainer.accelerator=cpu", f"runs={tmp_path / 'runs'}", *more)
    data = learnt(16, size)
    before = loss_of(classifier_of(cfg, 2), data)
    Run(cfg).prepare()
    train_model(Run(cfg), Splits(data, data, data, {}, 2))
    last = classifier_of(cfg, 2)
    last.load_state_dict(read_checkpoint(Run(cfg).folder / "last.ckpt")["state_dict"])
    return before, loss_of(last, data)


def test_a_network_is_not_worse_after_a_few_steps(tmp_path):
    before, after = tuned(tmp_path, "shufflenet_v2_x0_5", 32)
    assert after <= before * 1.02, (before, after)


def test_gradients_are_clipped_in_fine_tuning_alone(tmp_path, monkeypatch):
    seen = []

    def clip(self, optimizer, gradient_clip_val=None, gradient_clip_algorithm=None):
        seen.append(gradient_clip_val)

    monkeypatch.setattr(Classifier, "clip_gradients", clip)
    before, after = tuned(tmp_path, "small_resnet", 24)
    assert set(seen) == {1.0} and after <= before * 1.02
    seen.clear()
    tuned(tmp_path, "small_resnet", 24, "weights=null")
    assert set(seen) == {None}


def test_the_last_layers_are_frozen():
    cfg = configured("recipe=clean", "model=small_resnet", "data.size=24", "train.layers=0.5")
    classifier = classifier_of(cfg, 4)
    flags = [weight.requires_grad for weight in classifier.model.parameters()]
    assert flags == sorted(flags, reverse=True) and 0.3 < sum(flags) / len(flags) < 0.7
    assert not classifier.model.head.weight.requires_grad
    assert all(weight.requires_grad for weight in classifier_of(configured(), 4).model.parameters())
