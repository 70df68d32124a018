"""AdversarialMoire: samples, labels and types as v2.MixUp takes them."""

import numpy as np
import pytest
import torch
from torch import nn
from torchvision import tv_tensors
from torchvision.transforms import v2

from moireaug import Panel, Scene, Sensor
from moireaug.transforms import AdversarialMoire

SCENE = Scene(sensor=Sensor(gain=2.0))


@pytest.fixture
def model():
    torch.manual_seed(0)
    return nn.Sequential(nn.Flatten(), nn.Linear(3 * 9 * 12, 4))


IMAGES, LABELS = torch.rand(4, 3, 9, 12), torch.tensor([0, 1, 2, 3])


def attack(model, **settings):
    return AdversarialMoire(model, SCENE, steps=1, **settings)


def drawn(transform, *sample):
    return transform(*sample, generator=torch.Generator().manual_seed(0))


def test_a_tv_image_stays_one(model):
    for dtype, p in ((torch.uint8, 0.5), (torch.float32, 1.0)):
        images = IMAGES if dtype != torch.uint8 else IMAGES * 255
        images = tv_tensors.Image(images.to(dtype))
        shown, labels = drawn(attack(model, p=p), images, LABELS)
        assert type(shown) is tv_tensors.Image and shown.dtype == dtype and labels is LABELS
        plain, _ = drawn(attack(model, p=p), images.as_subclass(torch.Tensor), LABELS)
        assert type(plain) is torch.Tensor and torch.equal(plain, shown)
        assert not torch.equal(shown, images)


ONE_HOT = nn.functional.one_hot(LABELS, 4)
KINDS = {
    "float": LABELS.float(),
    "uint8": LABELS.to(torch.uint8),
    "one-hot": ONE_HOT,
    "one-hot float": ONE_HOT.double(),
    "one-hot bool": ONE_HOT.bool(),
    "one-hot uint16": ONE_HOT.to(torch.uint16),
    "mixed": 0.6 * ONE_HOT + 0.4 * ONE_HOT.flip(0),
    "numpy": np.arange(4),
    "numpy, high byte first": np.arange(4, dtype=">i4"),
    "numpy one-hot": np.eye(4, dtype=np.uint16),
}


def test_labels_of_any_kind_name_the_heaviest_class(model):
    expected = drawn(attack(model), IMAGES, LABELS)[0]
    for kind, labels in KINDS.items():
        shown, same = drawn(attack(model), IMAGES, labels)
        assert same is labels and torch.equal(shown, expected), kind
    with pytest.raises(TypeError, match="must hold numbers; got an array of <U1"):
        attack(model)(IMAGES, np.array(list("abcd")))


def test_mixing_may_come_first(model):
    for mix in (v2.MixUp, v2.CutMix):
        shown, labels = v2.Compose([mix(num_classes=4), attack(model)])(IMAGES, LABELS)
        assert shown.shape == IMAGES.shape and labels.shape == (4, 4)
        assert not torch.equal(shown, IMAGES)


def test_dict_samples(model):
    others = {"other": torch.rand(4, 2), "name": ["a", "b"]}
    expected = drawn(attack(model), IMAGES, LABELS)[0]
    for key in ("labels", "label", "class_label"):
        for sample in ({"image": IMAGES, key: LABELS}, {key: LABELS, "image": IMAGES}):
            sample |= others
            out = drawn(attack(model), sample)
            assert list(out) == list(sample) and out["name"] == ["a", "b"]
            assert out[key] is LABELS and out["other"] is sample["other"]
            assert torch.equal(out["image"], expected)


def test_labels_getter_says_where_the_labels_are(model):
    sample = (IMAGES, {"target": [torch.zeros(4), LABELS]})
    transform = attack(model, labels_getter=lambda s: s[1]["target"][1])
    shown, rest = drawn(transform, sample)
    assert torch.equal(shown, drawn(attack(model), IMAGES, LABELS)[0])
    assert rest["target"][0] is sample[1]["target"][0] and rest["target"][1] is LABELS


@pytest.mark.parametrize(
    ("sample", "sentence"),
    [
        ((), "one batch of images.*got nothing"),
        ((IMAGES, LABELS[:, None]), r"pass labels.squeeze\(1\)"),
        ((IMAGES, LABELS[:2]), r"shape \(4,\)"),
        ((IMAGES, LABELS + 0.5), "whole numbers"),
        ((IMAGES, torch.full((4,), torch.nan)), "whole numbers"),
        ((IMAGES, torch.randn(4, 4)), "weights >= 0"),
        ((IMAGES, torch.rand(4, 7)), r"one weight for each class, \(B, 4\) for .* got \(B, 7\)"),
        ((IMAGES, torch.rand(3, 4)), r"shape \(4, classes\)"),
        (({"image": IMAGES, "label": [0, 1, 2, 3]},), "labels must be a tensor.*labels_getter"),
        ((IMAGES[0], LABELS[:1]), r"one batch.*got the shape \(3, .*after batching"),
        ((tv_tensors.Video(IMAGES[None]), LABELS[:1]), "got a video.*after batching"),
        ((tv_tensors.Image(IMAGES), LABELS, tv_tensors.Image(IMAGES)), "one batch of images.*got"),
        ((IMAGES * 255, LABELS), "Divide them by 255"),
    ],
)
def test_what_is_no_batch_with_labels_gets_a_sentence(sample, sentence, model):
    with pytest.raises((TypeError, ValueError), match=sentence):
        attack(model)(*sample)


def test_photos_have_no_gradient_in_the_images(model):
    shown, _ = drawn(attack(model, p=0.5), IMAGES.clone().requires_grad_(), LABELS)
    assert not shown.requires_grad
    assert torch.equal(shown, drawn(attack(model, p=0.5), IMAGES, LABELS)[0])


def test_masks_beside_a_scene_in_the_cameras_frame_are_refused(model):
    mask = tv_tensors.Mask(torch.ones(4, 9, 12))
    sample = {"image": tv_tensors.Image(IMAGES), "label": LABELS, "mask": mask}
    assert attack(model)(sample)["mask"] is sample["mask"]
    with pytest.raises(ValueError, match="would not move with the images"):
        AdversarialMoire(model, "paper", steps=1)(sample)


def test_images_and_weights_may_differ_in_precision(model):
    floats = torch.float32, torch.float64, torch.bfloat16
    for weights in floats:
        for images in (torch.uint8, torch.float16, *floats):
            given = (IMAGES * 255 if images == torch.uint8 else IMAGES).to(images)
            shown, _ = drawn(attack(model.to(weights)), given, LABELS)
            assert shown.dtype == images and shown.float().isfinite().all(), (weights, images)
            assert not torch.equal(shown, given)


@pytest.mark.parametrize("channels", [1, 3])
def test_grey_images_reach_a_grey_model_as_luma(channels):
    torch.manual_seed(0)
    features = nn.Sequential(nn.Conv2d(channels, 4, 3), nn.BatchNorm2d(4))
    net = nn.Sequential(features, nn.Flatten(), nn.LazyLinear(4))
    net(torch.rand(2, channels, 9, 12))
    before = {name: value.clone() for name, value in net.state_dict().items()}
    grey = torch.rand(4, 1, 9, 12)
    shown, _ = drawn(attack(net, eps=0.1), grey, LABELS)
    plain, _ = drawn(attack(net, eps=0.0), grey, LABELS)
    assert shown.shape == grey.shape and not torch.equal(shown, plain)
    assert all(torch.equal(net.state_dict()[name], value) for name, value in before.items())


def test_the_memory_layout_is_kept(model):
    images = IMAGES.to(memory_format=torch.channels_last)
    for p in (0.0, 0.5, 1.0):
        shown, _ = drawn(attack(model, p=p), images, LABELS)
        assert shown.stride() == images.stride()
        assert torch.equal(shown, drawn(attack(model, p=p), IMAGES, LABELS)[0])


def test_a_scene_that_cannot_be_photographed_is_refused_when_it_is_made(model):
    slanted = Scene(sensor=Sensor(exposure="point"), panel=Panel(layout="chevron"))
    with pytest.raises(ValueError, match="slanted"):
        AdversarialMoire(model, slanted)
