"""Classifiers by name: shapes, gradients, and errors that say what to do."""

import pytest
import torch
from torch import nn

from moireaug.attacks import Normalized
from training.models import classifiers as models
from training.models.pooling import AttentionPooling
from training.models.small_convnet import AttentionConvNet
from training.models.small_resnet import SmallResNet

SMALL = {
    "resnet": lambda classes: SmallResNet(classes, 4),
    "resnet, attention": lambda classes: SmallResNet(classes, 4, activation=nn.SiLU, heads=3),
    "convnet": lambda classes: AttentionConvNet(classes, (4, 8, 8), heads=3),
    "convnet, one stage": lambda classes: AttentionConvNet(classes, (4, 8), heads=1),
}


@pytest.mark.parametrize("size", [(1, 1), (32, 32), (48, 48), (64, 64), (33, 47)])
@pytest.mark.parametrize("make", SMALL.values(), ids=SMALL)
def test_small_networks_map_images_to_logits(make, size):
    logits = make(7)(torch.rand(2, 3, *size))
    assert logits.shape == (2, 7) and logits.isfinite().all()


@pytest.mark.parametrize("make", SMALL.values(), ids=SMALL)
def test_every_parameter_and_the_image_receive_a_gradient(make):
    torch.manual_seed(0)
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
    model, images = make(5).eval(), torch.full((1, 3, 32, 32), 0.5)
    seen = []
    model.stem.register_forward_hook(lambda module, inputs, output: seen.append(inputs[0]))
    model(images)
    assert (seen[0] == 0).all() and (images == 0.5).all()


@pytest.mark.parametrize(("name", "side"), [("vit_b_16", 32), ("alexnet", 32)])
def test_a_size_that_a_model_cannot_take_is_refused(name, side):
    with pytest.raises(ValueError, match=rf"{name} cannot take images of {side} x {side} pixels"):
        models.check_side(models.as_model(name, 3, None), name, side)
    small = models.as_model("small_resnet", 3, None)
    models.check_side(small, "small_resnet", side)
    assert small.training


@pytest.mark.parametrize("make", SMALL.values(), ids=SMALL)
def test_small_networks_learn(make):
    generator = torch.Generator().manual_seed(0)
    labels = torch.arange(32) % 2
    images = torch.rand(32, 3, 32, 32, generator=generator) * 0.5
    images[labels == 1, :, :16] += 0.3
    torch.manual_seed(0)
    model = make(2)
    optimiser = torch.optim.SGD(model.parameters(), 0.05, momentum=0.9)
    for _ in range(15):
        optimiser.zero_grad()
        nn.functional.cross_entropy(model(images), labels).backward()
        optimiser.step()
    assert (model.eval()(images).argmax(1) == labels).all()


def test_own_models_take_images_as_they_are():
    built = {name: models.as_model(name, 5, None) for name in models.OWN_MODELS}
    assert not any(isinstance(model, Normalized) for model in built.values())


def test_names_hold_classifiers_only():
    assert models.model_names()[: len(models.OWN_MODELS)] == list(models.OWN_MODELS)
    assert {"resnet18", "mobilenet_v2", "vit_b_16"} < set(models.model_names())
    assert not any(
        "rcnn" in name or "raft" in name or "quantized" in name for name in models.model_names()
    )


BUILT = [*models.OWN_MODELS, "squeezenet1_1", "shufflenet_v2_x0_5", "mnasnet0_5", "regnet_x_400mf"]


@pytest.mark.parametrize("name", BUILT)
def test_a_model_has_the_number_of_classes_asked_for(name):
    assert models.as_model(name, 7).eval()(torch.rand(1, 3, 64, 64)).shape == (1, 7)


def test_googlenet_has_one_output_even_in_training():
    assert models.as_model("googlenet", 7)(torch.rand(2, 3, 64, 64)).shape == (2, 7)


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("resnet19", "Closest: resnet18"),
        ("small-resnet", "Closest: small_resnet"),
        ("", "Pass 'attention_convnet', 'attention_resnet'"),
    ],
)
def test_an_unknown_name_lists_the_closest(name, hint):
    with pytest.raises(ValueError, match=f"no model named {name!r}.*{hint}"):
        models.as_model(name, 7)
