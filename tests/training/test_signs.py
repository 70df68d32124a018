"""The sign data set: the same for the same seed, balanced, and neither trivial nor noise."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from training.config.data_sets import DATA
from training.data import sign_backgrounds, signs
from training.data.load import load

CLASS_COUNT = len(signs.CLASSES)


@pytest.fixture(scope="module")
def train():
    return signs.make("train", 20 * CLASS_COUNT, size=32)


@pytest.fixture(scope="module")
def test():
    return signs.make("test", 8 * CLASS_COUNT, size=32)


def nearest_mean_accuracy(train, test):
    images, labels = train[0].flatten(1).float(), train[1]
    means = torch.stack([images[labels == label].mean(0) for label in range(CLASS_COUNT)])
    nearest = torch.cdist(test[0].flatten(1).float(), means).argmin(1)
    return (nearest == test[1]).float().mean().item()


def distances(images, others):
    """Return the mean distance of each image from each other one, in codes."""
    return torch.cdist(images.flatten(1).float(), others.flatten(1).float(), p=1) / (3 * 32 * 32)


def test_images_are_uint8_planes_and_labels_int64():
    for size in (16, 33, 48):
        images, labels = signs.make("val", 5, size=size)
        assert images.shape == (5, 3, size, size)
        assert images.dtype == torch.uint8 and images.is_contiguous()
        assert labels.shape == (5,) and labels.dtype == torch.int64


def test_images_follow_the_seed_alone(train):
    torch.manual_seed(1)
    np.random.seed(1)
    signs.face.cache_clear()  # faces kept in memory are not drawn upon
    sign_backgrounds.noise_tile.cache_clear()
    images, labels = signs.make("train", CLASS_COUNT, size=32)
    assert torch.equal(images, train[0][:CLASS_COUNT])
    assert torch.equal(labels, train[1][:CLASS_COUNT])


@pytest.mark.parametrize("other", [{"split": "val"}, {"split": "test"}, {"seed": 1}])
def test_splits_and_seeds_share_no_image_and_no_order(train, other):
    images, labels = signs.make(**({"split": "train", "n": 64, "size": 32} | other))
    assert not torch.equal(labels, train[1][:64])
    assert distances(images, train[0]).min() > 2


def test_no_image_twice_in_one_split(train):
    images = train[0]
    assert (distances(images, images) + 255 * torch.eye(len(images))).min() > 2


def test_classes_are_balanced_to_within_one_image():
    for n in (1, CLASS_COUNT, 3 * CLASS_COUNT + 5, 200):
        labels = [signs.label_of("train", index) for index in range(n)]
        counts = np.bincount(labels, minlength=CLASS_COUNT)
        assert counts.sum() == n and counts.max() - counts.min() <= 1


def test_labels_come_in_another_order_in_every_block():
    labels = [signs.label_of("train", i) for i in range(20 * CLASS_COUNT)]
    blocks = {tuple(labels[i : i + CLASS_COUNT]) for i in range(0, len(labels), CLASS_COUNT)}
    assert len(blocks) == 20


@pytest.mark.parametrize("style", range(3))
def test_faces_are_distinct_opaque_and_premultiplied(style):
    faces = [np.asarray(signs.face(name, style, 128)) for name in signs.CLASSES]
    assert len({face.tobytes() for face in faces}) == CLASS_COUNT
    for face in faces:
        assert face[64, 64, 3] == 255
        assert (face[..., :3] <= face[..., 3:]).all()


def test_left_and_right_are_mirror_images():
    names = "turn_left", "turn_right"
    left, right = (np.asarray(signs.face(name, 1, 128)).astype(int) for name in names)
    assert np.abs(left - right).mean() > 5
    assert np.abs(left[:, ::-1] - right).mean() < 2


def test_pictures_use_the_range_without_burning_out(train):
    images = train[0].float()
    assert 70 < images.mean() < 150
    assert images.flatten(1).std(1).min() > 3
    assert ((images == 0) | (images == 255)).float().mean() < 0.15


def test_nearest_class_mean_beats_chance_without_solving_it(train, test):
    accuracy = nearest_mean_accuracy(train, test)
    assert 3 / CLASS_COUNT < accuracy < 0.6


def test_mean_colour_alone_does_not_give_the_class_away(train, test):
    train, test = ((images.float().mean((2, 3)), labels) for images, labels in (train, test))
    assert nearest_mean_accuracy(train, test) < 0.3


def test_a_size_at_which_the_signs_look_alike_is_refused():
    with pytest.raises(ValueError, match="size=8 is too small to tell the signs apart"):
        signs.make("train", 1, size=8)


def test_another_data_seed_draws_other_images():
    first, again, other = (
        load(replace(DATA["signs"], size=16, train=16, val=16, test=16, seed=seed)).test
        for seed in (0, 0, 1)
    )
    images, same, different = (
        torch.stack([image for image, _ in one]) for one in (first, again, other)
    )
    assert torch.equal(images, same)
    assert not (images == different).flatten(1).all(1).any()
