"""The capture against the released chain, and on every kind of input."""

import contextlib
import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, Shot, View, capture, develop, expose
from moireaug.engine import reference
from moireaug.scene.by_name import with_values
from moireaug.scene.geometry.lattice import SampledPixels
from moireaug.scene.presets import PRESETS

GOLDEN = np.load(Path(__file__).parent / "data" / "official_ma_golden.npz")


def golden_shot(scene):
    theta, phi, gamma = torch.from_numpy(GOLDEN["angles_theta_phi_gamma_deg"]).double().T
    shot = scene.sample(4, (48, 48))
    return with_values(shot, {"view.pitch": -theta, "view.yaw": phi, "view.roll": -gamma})


@pytest.mark.parametrize(("key", "brighten"), [("photos", 0.0), ("photos_plus20", 20 / 255)])
def test_paper_code_is_the_released_chain(key, brighten):
    scene = with_values(Scene.preset("paper_code"), {"develop.brighten": brighten})
    images = torch.from_numpy(GOLDEN["images"]).permute(0, 3, 1, 2).float() / 255
    shot = golden_shot(scene)
    turned = with_values(shot, {"view.roll": -shot.view.roll})  # the negative control
    photo, other = (capture(images, one).permute(0, 2, 3, 1) * 255 for one in (shot, turned))
    expected = torch.from_numpy(GOLDEN[key])
    assert (photo - expected).abs().max() < 0.02
    assert ((other - expected)[1:].abs() < 0.1).float().mean() < 0.9


def test_only_the_sensor_pixels_that_a_photo_reads_are_exposed():
    shot = Scene.preset("paper_code").sample(1, (48, 48))
    rows, cols = shot.sampled_pixels()
    # a lead that keeps the Bayer parity, and an even number
    assert len(rows.index) == len(cols.index) == 3 * 48 + 2
    full = with_values(shot.scene, {"develop.resize": "antialias"})
    assert full.sample(1, (48, 48)).raw_shape()[2] * 2 == 9 * 48


class Whole(Shot):
    """A shot that reads the whole sensor."""

    def sampled_pixels(self):
        counts = [round(side * self.scene.sensor.scale) for side in self.size]
        return tuple(
            SampledPixels(tuple(range(n + n % 2)), 0, 0, side, self.scene.sensor.scale)
            for n, side in zip(counts, self.size, strict=True)
        )


@pytest.mark.parametrize("scale", [5.0, 6.0, 9.0])
@pytest.mark.parametrize("size", [(12, 15), (7, 9)])
@pytest.mark.parametrize("demosaic", ["bilinear", "malvar"])
def test_reading_windows_is_reading_everything(scale, size, demosaic):
    """A point resize of the whole sensor gives the photo that its few windows give."""
    how = Develop(resize="point", demosaic=demosaic)
    base = Scene(panel=Panel(scale=2), view=View(roll=7), sensor=Sensor(scale=scale), develop=how)
    images = torch.rand(1, 3, *size, dtype=torch.float64)
    shot = base.sample(1, size)
    values = {f.name: getattr(shot, f.name) for f in dataclasses.fields(shot) if f.init}
    difference = capture(images, shot) - capture(images, Whole(**values))
    assert difference[..., 1:-1, 1:-1].abs().max() < 1e-9


@pytest.mark.parametrize("name", PRESETS)
def test_float32_stays_near_float64(name, images):
    # without noise, which is drawn again in each precision, and without JPEG, which makes a whole
    # code of a rounding error
    quiet = with_values(Scene.preset(name), {"sensor.read_noise": 0.0, "develop.jpeg": 0.0})
    images, shot = images[:2], quiet.sample(2, (24, 32))
    expected = capture(images.double(), shot)
    for execution, bound in ((reference(), 1e-5), (contextlib.nullcontext(), 1.5e-4)):
        with execution:
            difference = capture(images, shot) - expected
        assert difference.abs().mean() < bound
        assert difference.abs().quantile(0.999) < 2e-3  # sRGB is steep in the dark


def test_autocast_changes_nothing(images):
    scene = Scene.preset("screen_photo")
    shot = scene.sample(4, (24, 32))
    plain = capture(images, shot)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(capture(images, shot), plain)


def test_inference_mode_leaves_nothing_behind():
    """A shot of this size is captured first in inference mode, then with a gradient."""
    scene = Scene(view=View(yaw=10.0), lens=Lens(blur=0.3, k1=0.05), sensor=Sensor(scale=2.0))
    image, shot = torch.rand(1, 3, 61, 67, dtype=torch.float64), scene.sample(1, (61, 67))
    with torch.inference_mode():
        capture(image, scene.sample(1, (61, 67)))
    yaw = shot.view.yaw.clone().requires_grad_()
    capture(image, with_values(shot, {"view.yaw": yaw})).sum().backward()
    assert yaw.grad.isfinite().all()


def test_noise_enters_the_raw_reading(images):
    scene = Scene.preset("paper")
    shot = scene.sample(4, (24, 32))
    noise = 0.02 * torch.randn(shot.raw_shape())
    assert torch.equal(capture(images, shot, noise), develop(expose(images, shot) + noise, shot))
    assert not torch.equal(capture(images, shot, noise), capture(images, shot))
    with pytest.raises(ValueError, match=r"raw reading's shape"):
        capture(images, shot, noise[:2])


@pytest.mark.parametrize("resize", ["area", "antialias"])
def test_developing_keeps_the_dtype_and_computes_half_in_single(resize, images):
    scene = Scene(sensor=Sensor(scale=1.5), develop=Develop(resize=resize))
    shot = scene.sample(4, (24, 32))
    reading = expose(images, shot)
    assert develop(reading.double(), shot).dtype == torch.float64
    for dtype in (torch.float16, torch.bfloat16):
        raw = reading.to(dtype)
        assert torch.equal(develop(raw, shot), develop(raw.float(), shot).to(dtype))


BAD = [
    (lambda i: i.numpy(), TypeError, "must be a torch.Tensor"),
    (lambda i: (i * 255).to(torch.uint8), TypeError, "Divide uint8 images by 255"),
    (lambda i: i[0], ValueError, "(B, 3, H, W)"),
    (lambda i: i[:, :1], ValueError, "(B, 3, H, W)"),
    (lambda i: i[:2], ValueError, "drawn for 4 images of 24 x 32; got 2 of 24 x 32"),
]


@pytest.mark.parametrize(("spoil", "kind", "sentence"), BAD, ids=[b[2][:20] for b in BAD])
def test_wrong_images_get_a_sentence(spoil, kind, sentence, images):
    with pytest.raises(kind, match=re.escape(sentence)):
        capture(spoil(images), Scene().sample(4, (24, 32)))


@pytest.mark.parametrize(
    ("name", "value"), [("view.yaw", torch.nan), ("panel.scale", torch.inf), ("lens.k1", torch.nan)]
)
def test_a_shot_that_is_not_finite_is_named(name, value, images):
    shot = Scene.preset("screen_photo").sample(len(images), images.shape[-2:])
    broken = with_values(shot, {name: shot.numbers()[name] + value})
    with pytest.raises(ValueError, match=rf"shot\.{name}"):
        capture(images, broken)


def test_a_field_of_another_shape_is_named():
    shot = Scene(view=View(yaw=(0.0, 9.0))).sample(4, (24, 32))
    for value in (torch.tensor(5.0), torch.zeros(1), torch.zeros(3), torch.zeros(4, 1)):
        with pytest.raises(ValueError, match=r"here of shape \(4,\); got .* as shot.view.yaw"):
            with_values(shot, {"view.yaw": value})


@pytest.mark.parametrize(("name", "value"), [("panel.lit", -0.01), ("sensor.fill", 0.0)])
def test_a_number_that_no_scene_may_have_is_named(name, value):
    shot = Scene.preset("screen_photo").sample(1, (8, 8))
    wrong = with_values(shot, {name: torch.tensor([value], dtype=torch.float64)})
    with pytest.raises(ValueError, match=rf"shot.{name} lie in \[0.001, 1\]; got"):
        capture(torch.rand(1, 3, 8, 8), wrong)


def test_a_reading_is_not_the_callers_image():
    images = torch.full((1, 3, 8, 8), 0.5)
    nothing = Scene(panel=Panel(layout="even"), sensor=Sensor(cfa="none"))
    raw = expose(images, nothing.sample(1, (8, 8)))
    raw += 0.25
    assert (images == 0.5).all()


@pytest.mark.filterwarnings("ignore:.torch.jit.script:FutureWarning")  # PyTorch's own call
@pytest.mark.parametrize("dtype", [torch.float16, torch.int64])
def test_drawn_numbers_of_any_dtype_are_taken_in_float64(images, dtype):
    shot = Scene.preset("screen_photo").sample(len(images), images.shape[-2:])
    given = {name: values.to(dtype) for name, values in shot.numbers().items()}
    if dtype == torch.int64:  # where 0 is no value that a scene may have
        given = {name: values for name, values in given.items() if values.all()}
    changed = with_values(shot, given)
    same = with_values(shot, {name: values.double() for name, values in given.items()})
    assert all(values.dtype == torch.float64 for values in changed.numbers().values())
    assert torch.equal(capture(images, changed), capture(images, same))
    if dtype.is_floating_point:
        leaves = {name: values.requires_grad_() for name, values in given.items()}
        loss = capture(images, with_values(shot, leaves)).square().sum()
        found = torch.autograd.grad(loss, list(leaves.values()), allow_unused=True)
        moved = {
            name.split(".")[0]
            for name, slope in zip(leaves, found, strict=True)
            if slope is not None and slope.any()
        }
        assert moved == {"panel", "view", "lens", "sensor", "develop"}
        assert {slope.dtype for slope in found if slope is not None} == {dtype}


def test_the_size_of_a_shot_may_be_a_list(images):
    shot = Scene().sample(len(images), images.shape[-2:])
    listed = dataclasses.replace(shot, size=list(shot.size))
    assert torch.equal(capture(images, listed), capture(images, shot))
