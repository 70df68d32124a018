"""Weights of classifiers: files that come back unchanged, heads that are replaced, and errors that
say what to do."""

import argparse
from functools import partial
from pathlib import Path

import pytest
import torch
import torchvision

from moireaug.attacks import Normalized
from moireaug.common import extras
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


HEADS = {
    "small_resnet": {"head.weight", "head.bias"},
    "squeezenet1_1": {"classifier.1.weight", "classifier.1.bias"},
}


@pytest.mark.parametrize("name", HEADS)
def test_another_number_of_classes_replaces_the_head_alone(name, tmp_path):
    model = build(name, 7)
    path = saved(model, tmp_path / "weights.pth")
    assert same(model, build(name, 7, path), model.state_dict())
    for classes in (3, 1):
        tuned = build(name, classes, path)
        assert same(model, tuned, model.state_dict().keys() - HEADS[name])
        assert all(tuned.state_dict()[key].shape[0] == classes for key in HEADS[name])


def prefixed(prefix, state):
    return {prefix + key: value for key, value in state.items()}


def forms(state):
    """The files that training scripts write of these weights."""
    counters = {key for key in state if key.endswith("num_batches_tracked")}
    average = prefixed("module.", state) | {"n_averaged": torch.tensor(3)}
    zeros = {key: torch.zeros_like(value) for key, value in state.items()}
    beside = {"loss.weight": torch.ones(7), "accuracy.tp": torch.zeros(7)}  # losses and metrics
    optimizer = {"state": {}, "param_groups": [{"lr": 0.1}]}
    script = argparse.Namespace(lr=0.1, model="small_resnet")
    return {
        "without batch counters": {key: state[key] for key in state.keys() - counters},
        "model": {"model": state},
        "model, as torchvision's scripts write it": {"model": state, "epoch": 3, "args": script},
        "state_dict": {"state_dict": state, "epoch": 3, "arch": "resnet18"},
        "model_state_dict": {"model_state_dict": state, "optimizer_state_dict": optimizer},
        "state_dict beside a model's name": {"state_dict": state, "model": "small_resnet"},
        "module.": prefixed("module.", state),
        "model.": prefixed("model.", state),
        "_orig_mod.": prefixed("_orig_mod.", state),
        "module._orig_mod.": prefixed("module._orig_mod.", state),
        "AveragedModel": average,
        "LightningModule": {"state_dict": beside | prefixed("model.", state), "epoch": 3},
        "model before model_ema": {"model_ema": zeros, "model": state},
        "state_dict before state_dict_ema": {"state_dict_ema": zeros, "state_dict": state},
        "model_ema alone": {"model_ema": average, "model": "resnet"},
        "state_dict_ema alone": {"state_dict_ema": state, "epoch": 3},
        "ema_state_dict alone": {"ema_state_dict": state},
        "state_dict of model.model.": {"state_dict": prefixed("model.model.", state)},
    }


@pytest.mark.parametrize("classes", [7, 3])
def test_the_forms_of_checkpoints_load(classes, tmp_path):
    model = build("small_resnet", 7)
    kept = [key for key in model.state_dict() if classes == 7 or not key.startswith("head")]
    for name, content in forms(dict(model.state_dict())).items():
        torch.save(content, tmp_path / "weights.pth")
        again = build("small_resnet", classes, str(tmp_path / "weights.pth"))
        assert same(model, again, kept), name


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16])
def test_files_of_safetensors_load(dtype, tmp_path):
    model = build("small_resnet", 7).to(dtype)
    state = dict(model.state_dict())
    safetensors = pytest.importorskip("safetensors.torch")
    for content in (state, forms(state)["AveragedModel"]):
        safetensors.save_file(content, tmp_path / "weights.safetensors")
        again = build("small_resnet", 7, str(tmp_path / "weights.safetensors"))
        assert all(value.dtype == torch.float32 for value in again.parameters())
        assert same(model.float(), again, state)


def test_a_file_of_safetensors_names_the_package_that_is_missing(tmp_path, monkeypatch):
    path = tmp_path / "weights.safetensors"
    path.touch()
    monkeypatch.setitem(extras.MODULES, "safetensors", ("not_installed_here",))
    with pytest.raises(ValueError, match=r"needs not_installed_here, .*\[safetensors\]"):
        build("small_resnet", 7, str(path))


def test_every_other_mismatch_is_refused(tmp_path):
    state = dict(build("small_resnet", 7).state_dict())
    lacking = {key: value for key, value in state.items() if key != "norm.bias"}
    for content, sentence in (
        (prefixed("net.", state), 'Missing.*: "stem.weight", .* Unexpected.*: "net.stem.weight", '),
        (lacking, 'Missing key.*: "norm.bias"\\. Pass'),
        (prefixed("module.", lacking), 'Missing key.*: "norm.bias"\\. Pass'),
        (state | {"stem.weight": torch.zeros(16, 1, 3, 3)}, r"\[16, 1, 3, 3\].*\[16, 3, 3, 3\]"),
        (state | {"tail.weight": torch.zeros(2)}, 'Unexpected key.*: "tail.weight"'),
        (state | {"head.weight": torch.zeros(7, 63)}, r"head.weight: .*\[7, 63\].*\[7, 64\]"),
        (state | {"head.bias": torch.zeros(3)}, r"head.bias: .*\[3\].*\[7\]"),
        (SmallResNet(7, width=8).state_dict(), "size mismatch"),
    ):
        torch.save(content, tmp_path / "weights.pth")
        with pytest.raises(ValueError, match=f"do not fit 'small_resnet'.*{sentence}"):
            build("small_resnet", 7, str(tmp_path / "weights.pth"))


def test_weights_of_another_model_are_refused_even_with_other_classes(tmp_path):
    path = saved(build("squeezenet1_1", 7), tmp_path / "weights.pth")
    with pytest.raises(ValueError, match=r"do not fit 'small_resnet'.*Missing.*Unexpected"):
        build("small_resnet", 3, path)
    with pytest.raises(ValueError, match="do not fit 'squeezenet1_0'"):
        build("squeezenet1_0", 3, path)
    with pytest.raises(ValueError, match="lack the last layer of 'small_resnet'"):
        models.class_count_of("small_resnet", str(path))


class Wrapper(torch.nn.Module):
    """Keeps all of its layers under one name."""

    def __init__(self, attribute, num_classes):
        super().__init__()
        setattr(self, attribute, SmallResNet(num_classes))


@pytest.mark.parametrize("attribute", ["model", "module"])
def test_a_model_may_itself_look_like_a_wrapper(attribute, tmp_path, monkeypatch):
    monkeypatch.setitem(models.OWN_MODELS, attribute, partial(Wrapper, attribute))
    model = build(attribute, 7)
    path = saved(model, tmp_path / "weights.pth")
    assert models.class_count_of(attribute, path) == 7
    assert same(model, build(attribute, 7, path), model.state_dict())
    others = [key for key in model.state_dict() if ".head." not in key]
    assert same(model, build(attribute, 3, path), others)


class Opener:
    """Unpickling it would run code: the sort of file that must never be opened blindly."""

    def __reduce__(self):
        return (open, ("never-written", "w"))


@pytest.mark.parametrize("suffix", ["pth", "safetensors"])
def test_a_file_that_cannot_be_read_is_named(suffix, tmp_path, monkeypatch):
    if suffix == "safetensors":
        pytest.importorskip("safetensors")
    monkeypatch.chdir(tmp_path)
    path = tmp_path / f"weights.{suffix}"
    torch.save({"a": Opener()}, path)
    code = path.read_bytes()
    whole = Path(saved(build("small_resnet", 7), path)).read_bytes()
    flipped = bytes(255 - byte for byte in whole[:4000]) + whole[4000:]
    for content in (b"", b"<html>not found</html>", whole[: len(whole) // 2], flipped, code):
        path.write_bytes(content)
        message = rf"weights\.{suffix}' could not be read.*Fetch it again"
        with pytest.raises(ValueError, match=message):
            build("small_resnet", 7, str(path))
    assert not (tmp_path / "never-written").exists()


def test_a_file_that_holds_no_state_dict_is_named(tmp_path):
    path, tensor = tmp_path / "weights.pth", torch.zeros(2)
    dicts = ({"state_dict": {"a": 2}}, {"epoch": 3}, {"state_dict": {}}, {"model": [tensor]})
    for content in (*dicts, [tensor], tensor):
        torch.save(content, path)
        with pytest.raises(ValueError, match=r"weights\.pth' holds something other than a state_"):
            build("small_resnet", 7, str(path))


def test_a_missing_file_is_named_with_the_published_weights():
    with pytest.raises(ValueError, match=r"no weights file 'nowhere.pth'.*IMAGENET1K_V1"):
        build("squeezenet1_1", 7, "nowhere.pth")
    with pytest.raises(ValueError, match="no weights file 'DEFAULT'"):
        build("small_resnet", 7, "DEFAULT")


def test_published_weights_keep_the_trunk_and_fail_with_a_sentence(monkeypatch):
    published, original = build("squeezenet1_1", 1000), torchvision.models.get_model

    def get_model(name, weights=None, **options):
        if weights == "DEFAULT":
            return published
        if weights:
            raise OSError("no route to host")
        return original(name, **options)

    monkeypatch.setattr(torchvision.models, "get_model", get_model)
    tuned = build("squeezenet1_1", 7, "DEFAULT")
    trunk = [key for key in published.state_dict() if not key.startswith("classifier")]
    assert same(published, tuned, trunk)
    with pytest.raises(ValueError, match=r"of 'squeezenet1_1' could not be fetched.*no route"):
        build("squeezenet1_1", 7, "IMAGENET1K_V1")
