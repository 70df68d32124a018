"""The suite of shifts: corruptions are what they say; rows that other suites have are theirs."""

import dataclasses
import io
import itertools

import numpy as np
import pytest
import torch
from PIL import Image

from moireaug.evaluation import SuiteConfig
from moireaug.evaluation.conditions import EvalBatch
from moireaug.evaluation.suites.ladder import ladder
from moireaug.evaluation.suites.scenes import OWN_SCENE_ROW, other_scenes
from moireaug.scenes import Scene
from training.suites.corruptions import CORRUPTIONS, Corrupted
from training.suites.shifts import shifts

SCENE = Scene.preset("screen_photo")
AMOUNTS = [(name, amount) for name, (_, amounts) in CORRUPTIONS.items() for amount in amounts]


def batch_of(images, seed=0):
    n, size = len(images), images.shape[-2:]
    labels, generator = torch.zeros(n, dtype=torch.long), torch.Generator().manual_seed(seed)
    shot = SCENE.sample(n, size, torch.Generator().manual_seed(0))
    return EvalBatch(lambda x: x, images, labels, labels, shot, generator)


def shown(corruption, amount, images, seed=0):
    return Corrupted(corruption=corruption, amount=amount).show(batch_of(images, seed))


@pytest.mark.parametrize("size", [(24, 24), (17, 30), (1, 1), (1, 9)])
def test_a_corrupted_image_is_an_image(size):
    for dtype, case in itertools.product((torch.float32, torch.float64), AMOUNTS):
        images = torch.rand(2, 3, *size, generator=torch.Generator().manual_seed(1)).to(dtype)
        before = images.clone()
        found = shown(*case, images)
        assert found.shape == images.shape and found.dtype == dtype, case
        assert found.min() >= 0 and found.max() <= 1, case
        assert torch.equal(images, before), case
        assert torch.equal(found, shown(*case, images)), case


def test_the_stronger_case_is_further_from_the_image():
    ramp = torch.linspace(0.2, 0.8, 32).repeat(1, 3, 32, 1)
    images = ramp + 0.1 * torch.rand(1, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    for name, (_, amounts) in CORRUPTIONS.items():
        mild, strong = ((shown(name, amount, images) - images).norm() for amount in amounts)
        assert 0 < mild < strong, name


def test_noise_has_its_deviation_and_follows_the_generator():
    grey = torch.full((4, 3, 64, 64), 0.5)
    noise = shown("gaussian_noise", 0.1, grey) - grey
    assert noise.mean().abs() < 0.003 and noise.std().item() == pytest.approx(0.1, rel=0.02)
    assert not torch.equal(noise, shown("gaussian_noise", 0.1, grey, seed=1) - grey)


def test_blur_is_a_gaussian_of_its_share_of_the_side():
    point = torch.zeros(1, 3, 101, 101, dtype=torch.float64)
    point[..., 50, 50] = 1
    found = shown("gaussian_blur", 3, point)[0, 0]
    places = torch.arange(101, dtype=torch.float64) - 50
    assert found.sum().item() == pytest.approx(1)
    assert (found.sum(0) * places**2).sum().sqrt().item() == pytest.approx(3.03, rel=0.01)
    flat = torch.full((1, 3, 20, 20), 0.3)
    assert torch.allclose(shown("gaussian_blur", 3, flat), flat, atol=1e-6)


def test_contrast_is_the_distance_from_the_mean_grey():
    images = torch.rand(2, 3, 8, 8, generator=torch.Generator().manual_seed(2))
    weights = torch.tensor([0.299, 0.587, 0.114]).view(3, 1, 1)
    grey = (images * weights).sum(1, keepdim=True).mean((2, 3), keepdim=True)
    assert torch.allclose(shown("contrast", 0.4, images), grey + 0.4 * (images - grey), atol=1e-5)
    assert torch.allclose(shown("contrast", 1.0, images), images, atol=1e-6)


def test_jpeg_is_the_codecs_file():
    codes = np.random.default_rng(0).integers(0, 256, (16, 16, 3), dtype=np.uint8)
    file = io.BytesIO()
    Image.fromarray(codes).save(file, "JPEG", quality=25)
    decoded = torch.from_numpy(np.array(Image.open(file))).permute(2, 0, 1)[None] / 255
    images = torch.from_numpy(codes).permute(2, 0, 1)[None] / 255
    assert torch.allclose(shown("jpeg", 25, images), decoded, atol=1e-6)


def test_rows_are_scenes_photos_the_image_and_its_corruptions():
    table = shifts(SuiteConfig(scene=SCENE))
    corruptions = [f"{name}_{amount:g}" for name, amount in AMOUNTS]
    names = other_scenes(SuiteConfig(scene=SCENE))
    others = [OWN_SCENE_ROW, *names, "photo_jpeg_60", "camera_frame"]
    assert table.rows == [*others, "image", *corruptions]
    for row in table.rows:
        attacked = table.cell(row, "attacked")
        assert (attacked is None) == (row in corruptions)
    (own,) = table.cell(OWN_SCENE_ROW, "attacked").conditions
    rung = ladder(SuiteConfig(scene=SCENE)).cell("ma_4", "answer")
    assert own.settings() == rung.conditions[0].settings()


def test_photos_that_are_so_anyhow_are_not_asked_for_again():
    whole = shifts(SuiteConfig(scene=SCENE))
    for change, missing in (
        ({"jpeg": 80.0}, "photo_jpeg_60"),
        ({"registered": False}, "camera_frame"),
    ):
        develop = dataclasses.replace(SCENE.develop, **change)
        scene = dataclasses.replace(SCENE, develop=develop)
        table = shifts(SuiteConfig(scene=scene))
        assert missing not in table.rows and missing in whole.rows
