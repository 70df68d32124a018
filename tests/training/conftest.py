"""What the tests of runs share."""

import signal
import warnings

import pytest
import torch

from tests.training.frontier_runs import put
from tests.training.tiny_suites import configured
from training.attack import protocol as attacking
from training.attack import subject
from training.attack.protocol import protocol_of
from training.data.load import load
from training.models import classifiers as models


@pytest.fixture
def as_the_command_is():
    """Warnings are not errors, and Python's own handler of interruptions, which Lightning replaces,
    is put back."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def root(tmp_path):
    """Three recipes of three seeds; `slow` is beaten by `good`, and `lone` has one seed."""
    for seed in range(3):
        put(tmp_path, "clean", seed, worst=(0.01, 0.0), seconds=10.0 + seed)
        start = {"start": 10.0 + seed}
        put(tmp_path, "good", seed, worst=(0.3 + 0.02 * seed, 0.2), seconds=20.0, **start)
        put(tmp_path, "slow", seed, seconds=60.0, init="random", **start)
    put(tmp_path, "lone", 0, worst=(0.5, 0.25), seconds=100.0, collapsed=4)
    return tmp_path


@pytest.fixture(scope="session")
def weights(tmp_path_factory):
    """Return the weights of a small network that was never trained, but has the first image of the
    test right, so that one counts."""
    torch.manual_seed(0)
    model, cfg = models.as_model("small_resnet", 16).eval(), configured()
    images, labels = protocol_of(cfg, load(cfg.data)).batches[0]
    with torch.no_grad():
        logits, label = model(images)[0], labels[0]
        model.head.bias[label] += logits.max() - logits[label] + 1e-3
    path = tmp_path_factory.mktemp("weights") / "small.pt"
    torch.save(model.state_dict(), path)
    return path


@pytest.fixture
def nothing_attacked(monkeypatch):
    """No time may be spent."""
    for module, name in ((attacking.SuiteAttack, "run"), (subject, "load")):
        monkeypatch.setattr(module, name, lambda *args, **settings: pytest.fail("time was spent"))
