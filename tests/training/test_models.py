"""Classifiers by name: shapes, gradients, and errors that say what to do."""

import pytest
import torch
from torch import nn
from torchvision.models import VisionTransformer

from moireaug.attacks import Normalized
from training.config.schema import Config
from training.config.settings import settings_of
from training.models import classifiers as models
from training.models.pooling import AttentionPooling
from training.models.small_convnet import AttentionConvNet
from training.models.small_resnet import SmallResNet

SMALL = {
    "resnet": lambda classes: SmallResNet(classes, 4),
    "resnet, attention": lambda classes: SmallResNet(classes, 4, activation=nn.SiLU, heads=3),
    "convnet": AttentionConvNet,
}


@pytest.mark.parametrize("make", SMALL.values(), ids=SMALL)
def test_small_networks_map_images_to_logits(make):
    model = make(7)
    for size in ((1, 1), (32, 32), (48, 48), (33, 47)):
        logits = model(torch.rand(2, 3, *size))
        assert logits.shape == (2, 7) and logits.isfinite().all()


@pytest.mark.parametrize("make", SMALL.values(), ids=SMALL)
def test_every_parameter_and_the_image_receive_a_gradient(make):
    model = make(5)
    images = torch.rand(4, 3, 32, 32, requires_grad=True)
    nn.functional.cross_entropy(model(images), torch.arange(4)).backward()
    for parameter in model.parameters():
        assert parameter.grad is not None and parameter.grad.any()
    assert images.grad.any()


def test_attention_pooling_takes_the_mean_where_it_attends():
    x = torch.rand(2, 3, 4, 5, dtype=torch.float64)
    pool = AttentionPooling(3, heads=2).double()
    pool.score.weight.data.zero_()
    everywhere = x.mean((2, 3))
    assert torch.allclose(pool(x), torch.cat([everywhere, everywhere], 1))
    # the second head attends to where the first channel is large: to a single position
    pool.score.weight.data[1, 0] = 1000
    x[:, 0, 1, 2] = 2
    assert torch.allclose(pool(x), torch.cat([x.mean((2, 3)), x[:, :, 1, 2]], 1))


@pytest.mark.parametrize("make", SMALL.values(), ids=SMALL)
def test_small_networks_leave_their_input_alone_and_centre_it(make):
    model, images, seen = make(5).eval(), torch.full((1, 3, 32, 32), 0.5), []
    model.stem.register_forward_pre_hook(lambda module, inputs: seen.append(inputs[0]))
    model(images)
    assert (seen[0] == 0).all() and (images == 0.5).all()


class HeadFirst(nn.Module):
    """A network that defines its head before the rest."""

    def __init__(self, classes):
        super().__init__()
        self.head, self.stem = nn.Linear(8, classes), nn.Conv2d(3, 8, 3)


@pytest.mark.parametrize("name", ["head_first", "small_resnet", "regnet_y_400mf", "squeezenet1_1"])
def test_classes_are_counted_at_the_head_wherever_it_is(name, monkeypatch):
    monkeypatch.setitem(models.OWN_MODELS, "head_first", HeadFirst)
    state = models.as_model(name, 16).state_dict()
    before = torch.get_rng_state()
    assert models.class_count(name, state) == 16
    assert torch.equal(torch.get_rng_state(), before)
    stem = {key: value for key, value in state.items() if models._head_of(name) not in key}
    assert models.class_count(name, stem) == 0


def test_a_size_that_a_model_cannot_take_is_refused():
    transformer = VisionTransformer(224, 16, num_layers=1, num_heads=1, hidden_dim=8, mlp_dim=8)
    for model in (transformer, models.as_model("squeezenet1_1", 3)):
        with pytest.raises(ValueError, match="odd one cannot take images of 8 x 8 pixels"):
            models.check_side(model, "odd one", 8)
    small = models.as_model("small_resnet", 3)
    models.check_side(small, "small_resnet", 8)
    assert small.training


def test_own_models_take_images_as_they_are():
    built = {name: models.as_model(name, 5, None) for name in models.OWN_MODELS}
    assert not any(isinstance(model, Normalized) for model in built.values())


def test_the_help_names_every_own_model():
    assert all(name in settings_of(Config)["model"].help for name in models.OWN_MODELS)


def test_names_hold_classifiers_only():
    names = models.model_names()
    assert names[: len(models.OWN_MODELS)] == list(models.OWN_MODELS)
    assert {"resnet18", "mobilenet_v2", "vit_b_16"} < set(names)
    assert not any(other in " ".join(names) for other in ("rcnn", "raft", "quantized"))


@pytest.mark.parametrize("name", [*models.OWN_MODELS, "squeezenet1_1", "mnasnet0_5"])
def test_a_model_has_the_number_of_classes_asked_for(name):
    assert models.as_model(name, 7).eval()(torch.rand(1, 3, 64, 64)).shape == (1, 7)


def test_googlenet_has_one_output_even_in_training():
    assert models.as_model("googlenet", 7)(torch.rand(2, 3, 64, 64)).shape == (2, 7)


def test_an_unknown_name_lists_the_closest():
    for name, hint in (
        ("resnet19", "Closest: resnet18"),
        ("small-resnet", "Closest: small_resnet"),
        ("", "Pass 'attention_convnet', 'attention_resnet'"),
    ):
        with pytest.raises(ValueError, match=f"no model named {name!r}.*{hint}"):
            models.as_model(name, 7)
