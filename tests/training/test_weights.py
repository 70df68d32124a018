"""Weights of classifiers: files that come back unchanged, heads that are replaced, and errors that
say what to do."""

import argparse

import pytest
import torch
import torchvision

from moireaug import extras
from moireaug.attacks import Normalized
from training.models import classifiers as models
from training.models.small_resnet import SmallResNet


def build(*arguments):
    """Return a model without the normalisation and the memory layout that it is given."""
    model = models.as_model(*arguments).to(memory_format=torch.contiguous_format)
    return model.model if isinstance(model, Normalized) else model


def saved(model, path):
    torch.save(model.state_dict(), path)
    return str(path)


def same(one, other, keys):
    return all(torch.equal(one.state_dict()[key], other.state_dict()[key]) for key in keys)


@pytest.mark.parametrize(
    "name", ["small_resnet", "attention_resnet", "squeezenet1_1", "shufflenet_v2_x0_5"]
)
def test_weights_come_back_unchanged(name, tmp_path):
    model = build(name, 7)
    again = build(name, 7, saved(model, tmp_path / "weights.pth"))
    assert same(model, again, model.state_dict())


@pytest.mark.parametrize(
    ("name", "head"),
    [
        ("small_resnet", {"head.weight", "head.bias"}),
        ("squeezenet1_1", {"classifier.1.weight", "classifier.1.bias"}),
        ("shufflenet_v2_x0_5", {"fc.weight", "fc.bias"}),
    ],
)
@pytest.mark.parametrize("classes", [3, 1])
def test_another_number_of_classes_replaces_the_head_alone(name, head, classes, tmp_path):
    model = build(name, 7)
    tuned = build(name, classes, saved(model, tmp_path / "weights.pth"))
    assert same(model, tuned, model.state_dict().keys() - head)
    assert all(tuned.state_dict()[key].shape[0] == classes for key in head)


def test_files_without_batch_counters_load(tmp_path):
    model = build("small_resnet", 7)
    state = {
        key: value
        for key, value in model.state_dict().items()
        if not key.endswith("num_batches_tracked")
    }
    torch.save(state, tmp_path / "old.pth")
    assert same(model, build("small_resnet", 7, str(tmp_path / "old.pth")), state)


def prefixed(prefix):
    return lambda state: {prefix + key: value for key, value in state.items()}


def held(name, *beside):
    return lambda state: dict(beside) | {name: state}


def zeros(state):
    return {key: torch.zeros_like(value) for key, value in state.items()}


SETTINGS = argparse.Namespace(lr=0.1, model="small_resnet")
FORMS = {
    "model": held("model"),
    "model, as torchvision's scripts write it": held("model", ("epoch", 3), ("args", SETTINGS)),
    "state_dict": held("state_dict", ("epoch", 3), ("arch", "resnet18")),
    "model_state_dict": held(
        "model_state_dict", ("optimizer_state_dict", {"state": {}, "param_groups": [{"lr": 0.1}]})
    ),
    "state_dict beside a model's name": held("state_dict", ("model", "small_resnet")),
    "module.": prefixed("module."),
    "model.": prefixed("model."),
    "_orig_mod.": prefixed("_orig_mod."),
    "module._orig_mod.": prefixed("module._orig_mod."),
    "AveragedModel": lambda state: prefixed("module.")(state) | {"n_averaged": torch.tensor(3)},
    "state_dict of a LightningModule with a metric and a loss": lambda state: held(
        "state_dict", ("pytorch-lightning_version", "2.6.0")
    )({"loss.weight": torch.ones(7), "accuracy.tp": torch.zeros(7)} | prefixed("model.")(state)),
    "model before model_ema": lambda state: {"model_ema": zeros(state), "model": state},
    "state_dict before state_dict_ema": lambda state: {
        "state_dict_ema": zeros(state),
        "state_dict": state,
    },
    "model_ema alone, of an AveragedModel": lambda state: held("model_ema", ("model", "resnet"))(
        FORMS["AveragedModel"](state)
    ),
    "state_dict_ema alone": held("state_dict_ema", ("epoch", 3)),
    "ema_state_dict alone": held("ema_state_dict"),
    "state_dict of model.model.": lambda state: held("state_dict")(prefixed("model.model.")(state)),
}


@pytest.mark.parametrize("classes", [7, 3])
@pytest.mark.parametrize("name", FORMS)
def test_the_forms_of_checkpoints_load(name, classes, tmp_path):
    model = build("small_resnet", 7)
    torch.save(FORMS[name](dict(model.state_dict())), tmp_path / "weights.pth")
    again = build("small_resnet", classes, str(tmp_path / "weights.pth"))
    kept = [key for key in model.state_dict() if classes == 7 or not key.startswith("head")]
    assert same(model, again, kept)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16])
@pytest.mark.parametrize("form", ["plain", "AveragedModel"])
def test_files_of_safetensors_load(form, dtype, tmp_path):
    model = build("small_resnet", 7).to(dtype)
    state = dict(model.state_dict())
    safetensors = pytest.importorskip("safetensors.torch")
    safetensors.save_file(FORMS.get(form, dict)(state), tmp_path / "weights.safetensors")
    again = build("small_resnet", 7, str(tmp_path / "weights.safetensors"))
    assert all(value.dtype == torch.float32 for value in again.parameters())
    assert same(model.float(), again, state)


def test_a_file_of_safetensors_names_the_package_that_is_missing(tmp_path, monkeypatch):
    path = tmp_path / "weights.safetensors"
    path.touch()
    monkeypatch.setitem(extras.MODULES, "safetensors", ("not_installed_here",))
    with pytest.raises(ValueError, match=r"needs not_installed_here, .*moireaug\[safetensors\]'"):
        build("small_resnet", 7, str(path))


def one_less(state):
    return {key: value for key, value in state.items() if key != "norm.bias"}


def with_zeros(name, *shape):
    return lambda state: state | {name: torch.zeros(shape)}


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (
            prefixed("net."),
            'Missing key.*: "stem.weight", .* Unexpected key.*: "net.stem.weight", ',
        ),
        (lambda state: prefixed("module.")(one_less(state)), 'Missing key.*: "norm.bias"\\. Pass'),
        (
            with_zeros("stem.weight", 16, 1, 3, 3),
            r"stem.weight: .*\[16, 1, 3, 3\].*\[16, 3, 3, 3\]",
        ),
        (one_less, 'Missing key.*: "norm.bias"\\. Pass'),
        (with_zeros("tail.weight", 2), 'Unexpected key.*: "tail.weight"'),
        (with_zeros("head.weight", 7, 63), r"head.weight: .*\[7, 63\].*\[7, 64\]"),
        (with_zeros("head.bias", 3), r"head.bias: .*\[3\].*\[7\]"),
        (with_zeros("norm.weight", 3), r"norm.weight: .*\[3\].*\[64\]"),
    ],
)
def test_every_other_mismatch_is_refused(spoil, sentence, tmp_path):
    torch.save(spoil(dict(build("small_resnet", 7).state_dict())), tmp_path / "weights.pth")
    with pytest.raises(ValueError, match=f"do not fit 'small_resnet'.*{sentence}"):
        build("small_resnet", 7, str(tmp_path / "weights.pth"))


def test_weights_of_another_model_are_refused_even_with_other_classes(tmp_path):
    path = saved(build("squeezenet1_1", 7), tmp_path / "weights.pth")
    with pytest.raises(ValueError, match=r"do not fit 'small_resnet'.*Missing.*Unexpected"):
        build("small_resnet", 3, path)
    with pytest.raises(ValueError, match="do not fit 'squeezenet1_0'"):
        build("squeezenet1_0", 3, path)


def test_weights_of_another_width_are_refused(tmp_path):
    path = saved(SmallResNet(7, width=8), tmp_path / "weights.pth")
    with pytest.raises(ValueError, match="size mismatch"):
        build("small_resnet", 7, path)


class Opener:
    """Unpickling it would run code: the sort of file that must never be opened blindly."""

    def __reduce__(self):
        return (open, ("never-written", "w"))


@pytest.mark.parametrize("suffix", ["pth", "safetensors"])
@pytest.mark.parametrize("damage", ["empty", "text", "cut", "flipped", "code"])
def test_a_file_that_cannot_be_read_is_named(damage, suffix, tmp_path, monkeypatch):
    if suffix == "safetensors":
        pytest.importorskip("safetensors")
    monkeypatch.chdir(tmp_path)
    path = tmp_path / f"weights.{suffix}"
    saved(build("small_resnet", 7), path)
    whole = path.read_bytes()
    path.write_bytes(
        {"empty": b"", "text": b"<html>not found</html>", "cut": whole[: len(whole) // 2]}.get(
            damage, whole
        )
    )
    if damage == "flipped":
        path.write_bytes(bytes(255 - byte for byte in whole[:4000]) + whole[4000:])
    if damage == "code":
        torch.save({"a": Opener()}, path)
    with pytest.raises(ValueError, match=rf"weights\.{suffix}' could not be read.*Fetch it again"):
        build("small_resnet", 7, str(path))
    assert not (tmp_path / "never-written").exists()


@pytest.mark.parametrize(
    "content",
    [
        [torch.zeros(2)],
        {"state_dict": {"a": 2}},
        {"epoch": 3},
        {"state_dict": {}},
        {"model": [torch.zeros(2)]},
        torch.zeros(3),
    ],
)
def test_a_file_that_holds_no_state_dict_is_named(content, tmp_path):
    torch.save(content, tmp_path / "weights.pth")
    with pytest.raises(ValueError, match=r"weights\.pth' holds something other than a state_dict"):
        build("small_resnet", 7, str(tmp_path / "weights.pth"))


def test_a_missing_file_is_named_with_the_published_weights():
    with pytest.raises(ValueError, match=r"no weights file 'nowhere.pth'.*IMAGENET1K_V1"):
        build("squeezenet1_1", 7, "nowhere.pth")
    with pytest.raises(ValueError, match="no weights file 'DEFAULT'"):
        build("small_resnet", 7, "DEFAULT")


def test_published_weights_keep_the_trunk_and_fail_with_a_sentence(monkeypatch):
    published = build("squeezenet1_1", 1000)

    def get_model(name, weights=None, **options):
        assert name == "squeezenet1_1"
        return published if weights else original(name, **options)

    original = torchvision.models.get_model
    monkeypatch.setattr(torchvision.models, "get_model", get_model)
    tuned = build("squeezenet1_1", 7, "DEFAULT")
    assert same(
        published,
        tuned,
        [key for key in published.state_dict() if not key.startswith("classifier")],
    )

    def offline(name, weights=None, **options):
        if weights:
            raise OSError("no route to host")
        return original(name, **options)

    monkeypatch.setattr(torchvision.models, "get_model", offline)
    with pytest.raises(ValueError, match=r"of 'squeezenet1_1' could not be fetched.*no route"):
        build("squeezenet1_1", 7, "IMAGENET1K_V1")
