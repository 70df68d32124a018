"""Demoiréing networks: their size, any image, gradients, weights in files, and as a defence."""

import math

import pytest
import torch
from torch import nn

from moireaug.defenses import Compose, Defended, demoire
from moireaug.defenses.demoire import losses
from moireaug.evaluation.classifiers import DEFENCE_DRAWS, averaging_classifier

NETWORKS = sorted(demoire.NETWORKS)
# millions of parameters, as published: of the whole network, and of parts of it
PUBLISHED = {
    "mopnet": {"": 60.2, "edges": 6.95, "colour": 15.9, "stripes": 31.9},
    "mddm": {"": 8.01},
    "fhde2net": {"": 13.6, "gdn": 5.2, "lrn": 5.1, "fdn": 0.8, "frn": 2.5},
    "amnet": {"": 1.41},
    "esdnet": {"": 5.93},
}
# by how much each of a network's outputs is smaller than the image
SCALES = {"mopnet": [1, 1], "mddm": [1], "fhde2net": [1, 1, 4], "amnet": [1], "esdnet": [1, 2, 4]}


def small(name, width=0.1, seed=0):
    torch.manual_seed(seed)
    return demoire.build(name, width=width)


def pictures(*size, seed=0):
    return torch.rand(*size, generator=torch.Generator().manual_seed(seed))


def parameters(module):
    return sum(parameter.numel() for parameter in module.parameters())


@pytest.mark.parametrize("name", NETWORKS)
def test_parameters_are_as_many_as_published(name):
    with torch.device("meta"):
        whole, half = demoire.build(name), demoire.build(name, width=0.5)
    for part, millions in PUBLISHED[name].items():
        found = parameters(whole.get_submodule(part)) / 1e6
        assert found == pytest.approx(millions, rel=0.02), part
    assert parameters(half) / parameters(whole) == pytest.approx(1 / 4, rel=0.06)


@pytest.mark.parametrize("name", NETWORKS)
def test_images_of_any_size_keep_it(name):
    network = small(name).eval()
    for size in ((1, 1), (3, 40), (33, 17)):
        images = pictures(2, 3, *size)
        before = images.clone()
        with torch.no_grad():
            shown, outputs = network(images), network.outputs(images)
        assert torch.equal(images, before)
        assert shown.shape == images.shape and shown.dtype == images.dtype
        assert torch.equal(shown, outputs[0].clamp(0, 1))
        for output, scale in zip(outputs, SCALES[name], strict=True):
            assert output.shape == (2, 3, *(math.ceil(side / scale) for side in size))


@pytest.mark.parametrize("name", NETWORKS)
def test_images_of_a_batch_do_not_meet(name):
    """Also in training, and in the layout that is fast on a GPU: no statistics of the batch."""
    network = small(name)
    images = pictures(2, 3, 32, 32)
    with torch.no_grad():
        alone = torch.cat([network(image[None]) for image in images])
        network.to(memory_format=torch.channels_last)
        together = network(images.contiguous(memory_format=torch.channels_last))
    assert torch.allclose(together, alone, atol=1e-5)


@pytest.mark.parametrize("name", NETWORKS)
def test_the_loss_has_a_gradient_in_image_and_every_weight(name):
    network = small(name)
    images = pictures(2, 3, 48, 40).requires_grad_()
    loss = losses.LOSSES[name](network.outputs(images), pictures(2, 3, 48, 40, seed=1))
    loss.backward()
    gradients = {"images": images.grad}
    for key, parameter in network.named_parameters():
        gradients[key] = parameter.grad
    for key, gradient in gradients.items():
        assert gradient is not None and gradient.isfinite().all(), key
        assert gradient.abs().sum() > 0, key


@pytest.mark.parametrize("name", NETWORKS)
def test_a_clipped_answer_keeps_its_gradient(name):
    """A network that answers beyond white is white, and hides nothing from an attack."""
    network = small(name)
    with torch.no_grad():
        for layer in network.modules():
            is_last = isinstance(layer, nn.Conv2d) and layer.out_channels in (3, 12)
            if is_last and layer.bias is not None:
                layer.bias += 9.0
    images = pictures(1, 3, 32, 32).requires_grad_()
    shown = network(images)
    assert torch.equal(shown, torch.ones_like(shown))
    shown.sum().backward()
    assert images.grad.abs().sum() > 0
    unclipped = torch.autograd.grad(network.outputs(images)[0].sum(), images)[0]
    assert torch.allclose(images.grad, unclipped)


@pytest.mark.parametrize("name", NETWORKS)
def test_weights_come_back_from_their_file(name, tmp_path):
    network = small(name, seed=3).eval()
    file = tmp_path / "new folder/weights.pt"
    demoire.save(network, file)
    images = pictures(1, 3, 20, 20)
    with torch.no_grad():
        wanted = network(images)
        for read in (demoire.load(file), demoire.build(name, width=0.1, weights=file).eval()):
            assert (read.name, read.width, read.training) == (name, 0.1, False)
            assert torch.equal(read(images), wanted)
    assert [path.name for path in file.parent.iterdir()] == ["weights.pt"]


def test_a_file_of_another_network_is_refused(tmp_path):
    file = tmp_path / "amnet.pt"
    demoire.save(small("amnet"), file)
    for name, width, got in (("esdnet", 0.1, "esdnet of width 0.1"), ("amnet", 1, "width 1;|1\\.")):
        with pytest.raises(ValueError, match=f"holds amnet of width 0.1; you asked for .*{got}"):
            demoire.build(name, width=width, weights=file)


def test_files_that_hold_no_network_are_refused(tmp_path):
    network = small("amnet")
    demoire.save(network, tmp_path / "good.pt")
    good = torch.load(tmp_path / "good.pt", weights_only=True)
    file = tmp_path / "bad.pt"
    with pytest.raises(ValueError, match="there is no weights file"):
        demoire.load(file)
    for content, message in (
        (network.state_dict(), "holds no network, width and state"),
        (network, "could not be read .* or holds more than tensors"),
        (good | {"network": "unet"}, "holds a network 'unet', which this version does not know"),
        (good | {"network": ["amnet"]}, r"holds a network \['amnet'\]"),
        (good | {"width": "wide"}, "holds the width 'wide', which is no number"),
        (good | {"width": 9}, "width must be a finite number"),
        (good | {"state": {}}, "the weights in .* are not of amnet of width 0.1"),
        (good | {"state": None}, "the weights in .* are not of amnet of width 0.1"),
    ):
        torch.save(content, file)
        with pytest.raises(ValueError, match=message):
            demoire.load(file)
    file.write_bytes((tmp_path / "good.pt").read_bytes()[:999])
    with pytest.raises(ValueError, match="it is damaged"):
        demoire.load(file)


def test_mistakes_get_a_sentence():
    for ask, error, message in (
        (lambda: demoire.build("esdnt"), ValueError, "'esdnt'. Did you mean 'esdnet'"),
        (lambda: demoire.build("amnet", width=0), ValueError, "width must be .*; got 0"),
        (lambda: demoire.build("amnet", width=float("nan")), ValueError, "width must be"),
        (lambda: demoire.build("amnet", width="1"), TypeError, "width must be"),
        (lambda: demoire.save(nn.Identity(), "x.pt"), TypeError, "takes a network of demoire.b"),
        (lambda: demoire.Demoire(demoire.DemoireNet), TypeError, "to images; got"),
        (lambda: losses.VGGFeatures("none.pt", "esdnet"), ValueError, "vgg: there is no weights"),
        (lambda: small("amnet")(torch.zeros(2, 3, 8)), ValueError, r"shape \(B, 3, H, W\)"),
        (lambda: small("amnet")(torch.zeros(1, 8, 8, 3)), ValueError, "channels seem to be last"),
        (lambda: small("amnet")(torch.zeros(1, 3, 0, 8)), ValueError, "H, W >= 1"),
        (lambda: small("esdnet")(torch.zeros(0, 3, 8, 8)), ValueError, "one or more"),
        (lambda: small("amnet")(torch.zeros(1, 3, 8, 8).byte()), TypeError, "Divide uint8"),
    ):
        with pytest.raises(error, match=message):
            ask()


def mean_of(images):
    return images.mean((2, 3))


def test_a_network_is_a_defence():
    network = small("amnet")
    defence = demoire.Demoire(network)
    assert not defence.randomised and network.training
    images = pictures(2, 3, 12, 12)
    assert torch.equal(defence(images), network(images))
    defended = Defended(mean_of, defence)
    assert list(defended.networks) == [network]
    nested = Defended(mean_of, Compose((Compose((defence,)), network)))
    assert list(nested.networks) == [network] * 2
    images.requires_grad_()
    through = torch.autograd.grad(defended(images).sum(), images)[0]
    straight = torch.autograd.grad(mean_of(network(images)).sum(), images)[0]
    assert torch.equal(through, straight)
    assert defence(images.double()).dtype == torch.float64  # computed as its weights are
    assert defence(images[:0]).shape == (0, 3, 12, 12)


def test_ones_own_network_is_a_defence_too():
    def brighter(images):
        return images + 0.7

    defence = demoire.Demoire(brighter)
    images = pictures(1, 3, 4, 4).requires_grad_()
    shown = defence(images)
    assert torch.equal(shown, (images + 0.7).clamp(0, 1))
    shown.sum().backward()
    assert torch.equal(images.grad, torch.ones_like(images))
    with pytest.raises(ValueError, match=r"must keep the images' shape .* mean_of gave"):
        demoire.Demoire(mean_of)(images)
    with pytest.raises(ValueError, match="gave a list: pass a function that picks the images"):
        demoire.Demoire(lambda x: [x, x])(images)  # as networks of several scales do


def test_a_randomised_network_is_a_randomised_defence():
    network = small("amnet")
    network.randomised = True
    assert averaging_classifier("noisy", demoire.Demoire(network)).draws == DEFENCE_DRAWS
    assert Compose((demoire.Demoire(network),)).randomised
