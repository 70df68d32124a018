"""Parts and losses of demoiréing networks, each against its formula."""

import math

import pytest
import torch
import torchvision
from torch import nn

from moireaug.common.numeric import luma
from moireaug.defenses import demoire
from moireaug.defenses.demoire import fhde2net, layers, losses, mddm, mopnet
from tests.defaults import DTYPES, defaults


def pictures(*size, seed=0):
    return torch.rand(*size, generator=torch.Generator().manual_seed(seed))


def test_losses_are_those_of_their_formulae():
    target = pictures(1, 3, 8, 8)
    half = torch.nn.functional.interpolate(target, size=(4, 4), mode="bilinear")
    perfect = (target, half)
    assert losses.esdnet(perfect, target) == 0
    assert losses.esdnet((target + 0.25, half - 0.5), target).item() == pytest.approx(0.75)
    charbonnier = losses.mddm((target + 0.25,), target).item()
    assert charbonnier == pytest.approx(math.hypot(0.25, 1e-3))
    edges = mopnet.sobel(target)
    assert losses.mopnet((target, edges), target) == 0
    found = losses.mopnet((target + 0.5, edges + 0.1), target, lambda x: 2 * x).item()
    assert found == pytest.approx(0.25 + 0.01 + 0.1 * 1.0)
    found = losses.esdnet((target + 0.25,), target, lambda x: 2 * x).item()
    assert found == pytest.approx(0.25 + 0.5)


def test_perceptual_features_are_those_of_the_file(tmp_path):
    with torch.device("meta"):
        vgg = torchvision.models.vgg16().features
    state = {}
    for key, value in vgg.state_dict().items():
        state[f"features.{key}"] = 0.05 * pictures(*value.shape).half()
    torch.save(state, tmp_path / "vgg16.pth")
    images = pictures(1, 3, 16, 16)
    for network, shape in {"esdnet": (1, 256, 4, 4), "mopnet": (1, 64, 16, 16)}.items():
        features = losses.VGGFeatures(tmp_path / "vgg16.pth", network)
        assert features(images).shape == shape
        assert not any(parameter.requires_grad for parameter in features.parameters())
    loss = losses.LOSSES["mopnet"]((images, mopnet.sobel(images)), images * 0.5, features)
    assert loss > losses.LOSSES["mopnet"]((images, mopnet.sobel(images)), images * 0.5)


def test_sobel_is_one_on_an_upright_step():
    step = torch.zeros(1, 3, 6, 6)
    step[..., 3:] = 1.0
    found = mopnet.sobel(step)
    assert torch.allclose(found[..., 2:4], torch.ones(6, 2), atol=1e-3)
    assert found[..., :2].abs().max() < 1e-6 and found[..., 4:].abs().max() < 1e-6


def test_the_cosine_transform_is_its_own_inverse():
    basis = fhde2net.cosines()
    flat = basis.flatten(1)
    assert torch.allclose(flat @ flat.T, torch.eye(64), atol=1e-6)
    network = fhde2net.Spectral(8)
    for parameter in network.body[-1].parameters():
        nn.init.zeros_(parameter)
    images = pictures(1, 3, 16, 24)
    assert torch.allclose(network(images), luma(images), atol=1e-5)


def test_only_new_networks_follow_torchs_defaults(tmp_path):
    path, images = tmp_path / "weights.pt", pictures(1, 3, 8, 8)
    demoire.save(demoire.build("fhde2net", width=0.1), path)  # has buffers that no file holds
    expected = demoire.load(path)(images)
    for dtype in DTYPES:
        with defaults(dtype):
            assert torch.equal(demoire.load(path)(images), expected)
            built = demoire.build("fhde2net", width=0.1, weights=path)
        assert torch.equal(built(images), expected)
    with defaults(torch.float64, "cpu"):
        network = demoire.build("fhde2net", width=0.1)
    assert network(pictures(1, 3, 8, 8).double()).dtype == torch.float64


def test_adain_gives_the_statistics_of_the_other():
    x, like = pictures(2, 4, 9, 9), 3 * pictures(2, 4, 5, 5, seed=1) - 1
    found = mddm.adain(x, like)
    assert torch.allclose(found.mean((2, 3)), like.mean((2, 3)), atol=1e-5)
    deviations = [y.std((2, 3), correction=0) for y in (found, like)]
    assert torch.allclose(*deviations, rtol=1e-3)
    flat = torch.ones(1, 4, 3, 3, requires_grad=True)  # no division by its deviation
    mddm.adain(flat, like[:1]).sum().backward()
    assert flat.grad.isfinite().all()


def test_attention_stays_within_its_region():
    torch.manual_seed(0)
    layer = layers.RegionAttention(4)
    images = pictures(1, 4, 16, 24).requires_grad_()
    layer(images)[0, :, 10, 17].sum().backward()
    reached = images.grad.abs().sum((0, 1)) > 0
    expected = torch.zeros(16, 24, dtype=torch.bool)
    expected[8:16, 16:24] = True
    assert torch.equal(reached, expected)
