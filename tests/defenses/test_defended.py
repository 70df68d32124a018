"""Defences in a row, and a model behind one."""

import copy
import math

import pytest
import torch
from torch import nn

from moireaug import Scene, attacks
from moireaug.defenses import (
    JPEG,
    BitDepth,
    Compose,
    Defended,
    Gain,
    Median,
    PixelDeflection,
    Rejecting,
)
from moireaug.defenses.demoire import Demoire
from moireaug.evaluation.classifiers import DEFENCE_DRAWS, averaging_classifier
from tests.defenses.test_every_defence import ALL


class Mean(nn.Module):
    """Logits that can be checked by hand, and noise in training mode."""

    def __init__(self):
        super().__init__()
        self.drop = nn.Dropout(0.5)

    def forward(self, x):
        return self.drop(x.mean((2, 3)) * 10)


class Noisy(Mean):
    randomised = True

    def forward(self, x):
        return super().forward(x) + torch.randn(len(x), 3)


def test_a_row_goes_in_order_and_takes_networks(photos):
    images = photos()
    row = Compose((Median(3), Gain(0.3)))
    assert torch.equal(row(images), Gain(0.3)(Median(3)(images)))
    assert not torch.equal(row(images), Median(3)(Gain(0.3)(images)))
    network = nn.Conv2d(3, 3, 3, padding=1)
    row = Compose((network, Median(2)))
    assert not row.randomised
    out = row(images)
    assert torch.equal(out, Median(2)(network(images).clamp(0, 1)))
    with pytest.raises(ValueError, match="Conv2d gave"):
        Compose((nn.Conv2d(3, 3, 3),))(images)


def test_defended_is_the_model_behind_the_defence(photos):
    images, model = photos(), Mean().eval()
    assert torch.equal(Defended(model, Median(3))(images), model(Median(3)(images)))
    of_function = Defended(lambda x: x.mean((2, 3)), Median(3))
    assert torch.equal(of_function(images), Median(3)(images).mean((2, 3)))


def test_draws_are_averaged_as_probabilities(photos):
    images, model, defence = photos(), Mean().eval(), PixelDeflection(100)
    torch.manual_seed(2)
    out = Defended(model, defence, draws=3)(images)
    torch.manual_seed(2)
    each = [model(defence(images)).softmax(1) for _ in range(3)]
    assert torch.allclose(out.exp(), sum(each) / 3, atol=1e-6)
    assert not torch.allclose(out.exp(), each[0], atol=1e-5)
    assert torch.allclose(out.exp().sum(1), torch.ones(2))


def test_draws_of_a_model_that_rules_a_class_out_have_its_gradient(photos):
    images, labels = photos().requires_grad_(), torch.zeros(2, dtype=torch.int64)
    ruled_out = torch.tensor([False, False, True])

    def model(images):
        return Mean().eval()(images).masked_fill(ruled_out, -math.inf)

    model.randomised = True
    slopes = []
    for draws in (1, 5):
        logits = Defended(model, Compose(()), draws)(images)
        assert logits.isneginf().tolist() == [[False, False, True]] * 2
        loss = attacks.LOSSES["ce"](logits, labels).sum()
        slopes += torch.autograd.grad(loss, images)
    assert slopes[0].abs().max() > 0 and torch.allclose(*slopes)


def test_a_random_model_is_drawn_again_and_no_draws_of_nothing_are_taken(photos):
    """The mean of answers has as many times less variance as there are draws."""
    images = photos()[:1].repeat(2000, 1, 1, 1)

    torch.manual_seed(0)
    spread = {}
    for draws in (1, 16):
        model = Defended(attacks.Normalized(Noisy()), Compose(()), draws=draws).eval()
        assert model.randomised
        spread[draws] = model(images[:, :, ::8, ::8]).softmax(1).var(0).sum()
    assert spread[1] / spread[16] == pytest.approx(16, rel=0.2)
    with pytest.raises(ValueError, match=r"draws = 16.*randomised = True"):
        Defended(Mean(), Compose(()), draws=16)


def test_a_model_is_random_where_a_network_inside_it_is(photos):
    images = photos()[:, :, ::8, ::8]
    shot = Scene().sample(len(images), (images.shape[-2], images.shape[-1]))
    wrapped = attacks.Photographed(Noisy(), images, shot, noise_at="image")
    rejecting = Rejecting(Noisy(), lambda x: x.mean((1, 2, 3)), 0.5)
    for model in (wrapped, rejecting, nn.Sequential(Noisy()), lambda x: wrapped(x)):
        assert Defended(model, Compose(()), draws=2)(images).shape[0] == len(images)
        assert averaging_classifier("noisy", model).draws == DEFENCE_DRAWS


def test_a_randomised_defence_is_drawn_again_and_few_images_together(photos):
    few, many = photos()[:2], photos().repeat(10, 1, 1, 1)
    for images, randomised, draws, calls in (
        (few, False, 1, [2]),
        (few, True, 1, [2]),
        (few, True, 5, [10]),
        (few, True, 20, [32, 8]),
        (many, True, 3, [20, 20, 20]),
    ):
        asked = []

        def defence(images, asked=asked):
            asked.append(len(images))
            return images

        defence.randomised = randomised
        out = Defended(Mean().eval(), defence, draws)(images)
        assert asked == calls and out.shape == (len(images), 3)


def test_modules_are_reached_wherever_they_stand(photos):
    network = nn.Sequential(nn.Conv2d(3, 3, 1), nn.Dropout(0.5))
    for defence in (network, Compose((Gain(), network)), Compose((Compose((network,)), Gain()))):
        model = Defended(Mean(), defence)
        assert len(list(model.parameters())) == 2
        with attacks.evaluating(model):
            assert not network[1].training and not model.model.training
            assert torch.equal(model(photos()), model(photos()))
        assert network[1].training and model.model.training
        copied = copy.deepcopy(model)
        assert copied.networks[0] is not network
        with torch.no_grad():
            copied.networks[0][0].bias += 1  # a copy's defence runs on the copy's weights
        assert not torch.equal(copied.eval()(photos()), model.eval()(photos()))
        model.train()


ATTACKED = {name: ALL[name] for name in ("jpeg_60", "median_3", "tvm", "gain", "quilting")} | {
    "bits_2": lambda: BitDepth(2),
    "pixel_deflection": lambda: PixelDeflection(20, sigma=0.2),
}


@pytest.mark.parametrize("name", ATTACKED)
def test_an_attack_goes_through_the_defence(name):
    """One that is unaware of it takes the model's slope where the defence shows no image."""
    g = torch.Generator().manual_seed(3)
    images, labels = torch.rand(4, 3, 16, 16, generator=g), torch.tensor([0, 1, 2, 0])
    linear, waves = 0.02 * torch.randn(2, 3, 768, generator=g)

    def wavy(x):
        x = x.flatten(1)
        return x @ linear.T + torch.cos(6 * torch.pi * x) @ waves.T

    defence = ATTACKED[name]()
    model = Defended(wavy, defence, draws=2 if defence.randomised else 1)
    losses = []
    for known in (wavy, model):
        torch.manual_seed(0)
        attacked = attacks.PGD(known, eps=16 / 255, steps=3)(images, labels).images
        torch.manual_seed(1)
        losses.append(nn.functional.cross_entropy(model(attacked), labels).item())
    assert losses[1] > losses[0] + 0.05, losses


def test_an_image_without_an_answer_leaves_the_others_theirs(photos):
    """A network's NaN in one image, before a defence that would refuse the batch."""
    images = photos()
    broken = torch.tensor([torch.nan, 0.0]).view(2, 1, 1, 1)
    out = Compose((lambda x: x + broken, JPEG(60)))(images)
    assert out[0].isnan().all() and torch.equal(out[1], JPEG(60)(images)[1])


def test_no_images_pass_a_network(photos):
    def network(images):
        raise AssertionError("called without images")

    assert Compose((network,))(photos()[:0]).shape == (0, 3, 32, 40)


@pytest.mark.parametrize("draws", [1, 2])
def test_a_model_may_work_in_place_behind_every_defence(photos, draws):
    images = photos(h=16, w=16).requires_grad_()
    for name, make in ALL.items():
        gradients = []
        for model in (lambda x: (x - 0.1).mean((2, 3)), lambda x: x.sub_(0.1).mean((2, 3))):
            torch.manual_seed(0)
            defence = make()
            logits = Defended(model, defence, draws if defence.randomised else 1)(images)
            gradients.append(torch.autograd.grad(logits[:, 0].sum(), images)[0])
        assert torch.equal(*gradients) and gradients[0].any(), name


def test_a_defence_that_works_in_place_leaves_the_images_alone(photos):
    def halve(x):
        return x.mul_(0.5)

    for defence in (Compose((halve,)), Demoire(halve), Defended(Mean(), halve)):
        images = photos()
        defence(images)
        assert torch.equal(images, photos())
