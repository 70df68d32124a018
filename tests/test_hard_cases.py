"""The hard cases of numerical stability: each is finite and near its float64 answer, or a clear
error."""

import dataclasses

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, capture, expose, transforms
from moireaug.attacks import MoireAttack
from moireaug.scene.by_name import with_values
from moireaug.scene.layout import Layout
from tests.photo_checks import in_range

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
# Mean distance from the float64 answer on the same image. Half precision is computed in float32, so
# it is off by its own rounding alone; float32 by that of coordinates, which the plan keeps under
# half the tolerance of 1/512.
NEAR = {torch.float16: 3e-4, torch.bfloat16: 3e-3, torch.float32: 1e-3}
HALVES = torch.float16, torch.bfloat16

SOFT = Lens(blur=0.3)
CASES = {
    **{f"yaw {a}": Scene(view=View(yaw=a), lens=SOFT) for a in (60.0, 80.0, 89.0, -89.0)},
    "grazing, near": Scene(view=View(yaw=89, pitch=89, fov=89), lens=SOFT),
    "grazing, zoomed in": Scene(view=View(pitch=85, fov=80, zoom=20), lens=SOFT),
    **{f"roll {a}": Scene(view=View(roll=a), lens=SOFT) for a in (0.0, 90.0, 180.0)},
    "released, no roll": Scene(view=View(pose="released"), develop=Develop(registered=False)),
    "released, hardly a roll": Scene(view=View(pose="released", roll=1, yaw=19)),
    "pitch of the sensor": Scene(panel=Panel(scale=1.0)),
    "pitch of two": Scene(panel=Panel(scale=1.0), sensor=Sensor(scale=2)),
    "pitch to zero": Scene(panel=Panel(scale=1000.0)),
    "pitch to infinity": Scene(panel=Panel(scale=1e-3), view=View(zoom=100)),
    "less than a pixel": Scene(view=View(zoom=1e-3)),
    "a screen far beyond the horizon": Scene(
        panel=Panel(scale=22178.0), view=View(yaw=89, zoom=1 / 128)
    ),
    "out of sight": Scene(view=View(shift_x=1, shift_y=-1, roll=5)),
    "nearly folded": Scene(lens=Lens(k1=-0.3, k2=0.0, blur=0.3), view=View(roll=5)),
    "bent to the limit": Scene(lens=Lens(k1=1, k2=1, blur=0.3)),
    "pinhole pixels": Scene(sensor=Sensor(fill=1e-3)),
    "pinholes before a near panel": Scene(
        panel=Panel(scale=0.01), sensor=Sensor(fill=1e-3, scale=2)
    ),
    "hairs": Scene(panel=Panel(lit_x=1e-3), sensor=Sensor(gain=100)),
    "slanted to a line": Scene(panel=Panel(layout=Layout(((1, 0.5, 0.5, 0.5, 0.499, 0.5, 0.5),)))),
    "no focus": Scene(lens=Lens(blur=20)),
    "strong low-pass": Scene(lens=Lens(olpf=4)),
    "hardly lit": Scene(panel=Panel(lit=1e-3), sensor=Sensor(gain=1000)),
    "black corners": Scene(lens=Lens(vignetting=0.99, blur=1)),
    "overexposed": Scene(sensor=Sensor(gain=1000), develop=Develop(linear_light=True)),
    "noise alone": Scene(sensor=Sensor(read_noise=1, shot_noise=1)),
    "one bit": Scene(lens=Lens(blur=2), sensor=Sensor(bits=1, gain=1.1)),
    "fast flicker": Scene(
        panel=Panel(pwm=1e6, duty=1e-3), sensor=Sensor(shutter=3600, readout=3600)
    ),
    "hardly a pulse": Scene(
        panel=Panel(pwm=50, duty=1e-3), sensor=Sensor(shutter=1e-6, readout=0.02)
    ),
    "bright": Scene(develop=Develop(brighten=1)),
    "dark": Scene(develop=Develop(brighten=-1)),
    "gains": Scene(develop=Develop(red=100, blue=1e-3)),
    "no tolerance": Scene(tolerance=0.0),
    "any tolerance": Scene(tolerance=1.0),
    "worst file": Scene(lens=Lens(blur=2), develop=Develop(jpeg=1)),
    "best file": Scene(lens=Lens(blur=2), develop=Develop(jpeg=100)),
    "all black level": Scene(panel=Panel(black=1.0), develop=Develop(linear_light=True)),
    "more glare than screen": Scene(panel=Panel(glare=10, glare_x=0.5, glare_y=-0.5), lens=SOFT),
    "long motion": Scene(lens=Lens(motion_x=20, motion_y=-20, blur=0.3)),
    "motion across a slanted view": Scene(view=View(yaw=80), lens=Lens(motion_y=5, blur=0.3)),
    "most crosstalk": Scene(
        lens=SOFT, sensor=Sensor(crosstalk=0.3), develop=Develop(saturation=4, linear_light=True)
    ),
    "no colour": Scene(lens=SOFT, develop=Develop(saturation=0, chroma_blur=20)),
    "most contrast": Scene(lens=SOFT, develop=Develop(contrast=1)),
    "most shoulder": Scene(lens=SOFT, develop=Develop(shoulder=10, linear_light=True)),
    "least contrast": Scene(lens=SOFT, develop=Develop(contrast=-1, linear_light=True)),
    "blurred by less than a pixel": Scene(lens=SOFT, develop=Develop(chroma_blur=1e-9)),
    "sharpened to the limit": Scene(lens=SOFT, develop=Develop(sharpen=10, sharpen_radius=20)),
    "no blur of a blurring scene": Scene(
        lens=SOFT, develop=Develop(chroma_blur=(0, 1e-6), sharpen=(0, 1), sharpen_radius=0.3)
    ),
    "point": Scene(
        panel=Panel(scale=3), view=View(roll=45), sensor=Sensor(scale=9, exposure="point")
    ),
    "supersample": Scene(view=View(yaw=80), sensor=Sensor(exposure="supersample:2")),
}
# Where a rounding decides between two levels, pixels differ by a whole one, and only finiteness can
# be asked for.
STEPS = {"one bit", "worst file", "best file", "supersample", "less than a pixel"}
STEPS |= {"grazing, near", "hardly a pulse"}
RANDOM = torch.rand(2, 3, 9, 12, generator=torch.Generator().manual_seed(5))
IMAGES = torch.cat([RANDOM, torch.zeros(1, 3, 9, 12), torch.ones(1, 3, 9, 12)]).double()


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("name", CASES)
def test_finite_and_near_float64(name, device):
    image = IMAGES.to(device)
    shot = CASES[name].sample(len(image), (9, 12), torch.Generator().manual_seed(1)).to(device)
    half = HALVES[list(CASES).index(name) % 2]  # in turn
    rounded = [image.to(dtype) for dtype in (half, torch.float32)]
    answers = capture(torch.cat(rounded).double(), shot.repeat(2)).chunk(2)
    for given, answer in zip(rounded, answers, strict=True):
        dtype = given.dtype
        photo = capture(given, shot)
        for found in (photo, answer):
            assert in_range(found, image)
        assert photo.dtype == dtype and answer.dtype == torch.float64
        if name not in STEPS and "noise" not in name:
            assert ((photo.double() - answer).abs().mean((1, 2, 3)) < NEAR[dtype]).all()


@pytest.mark.parametrize("name", CASES)
def test_gradients_are_finite(name):
    image = RANDOM.double()[:1, :, :5, :7].requires_grad_()
    shot = CASES[name].sample(1, (5, 7), torch.Generator().manual_seed(1))
    leaves = {name: values.clone().requires_grad_() for name, values in shot.numbers().items()}
    noise = torch.zeros(shot.raw_shape(), dtype=torch.float64, requires_grad=True)
    photo = capture(image, with_values(shot, leaves), noise)
    wanted = (image, noise, *leaves.values())
    gradients = torch.autograd.grad(photo.sum(), wanted, allow_unused=True)
    assert gradients[0] is not None and gradients[1] is not None
    assert all(g.isfinite().all() for g in gradients if g is not None)


SIZES = [(1, 1), (1, 9), (9, 1), (2, 3), (15, 17)]
EXPOSURES = ["spectral", "box", "mean", "point", "supersample:2"]
SENSORS = [(cfa, denoise) for cfa in ("rggb", "none") for denoise in (None, "nlm", "bilateral")]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("exposure", EXPOSURES)
def test_every_size_and_exposure_with_sensors_in_turn(size, exposure):
    turn = SIZES.index(size) + EXPOSURES.index(exposure)
    cfa, denoise = SENSORS[turn % len(SENSORS)]
    for layout, demosaic in (("pentile", "malvar"), ("led", "bilinear")):
        filters = {"denoise": denoise, "demosaic": demosaic, "chroma_blur": 1.0, "sharpen": 0.5}
        scene = Scene(
            panel=Panel(layout=layout, scale=0.8), view=View(yaw=20, roll=5),
            lens=Lens(k1=0.1, blur=0.2), sensor=Sensor(scale=1.5, cfa=cfa, exposure=exposure),
            develop=Develop(jpeg=50, linear_light=True, **filters),
        )  # fmt: skip
        image = torch.rand(2, 3, *size)
        assert in_range(scene.capture(image), image)


SOFT_AND_NEAR = {
    "blur from 0 to 5": Scene(panel=Panel(scale=0.2, layout="led"), lens=Lens(blur=(0, 5))),
    "low-pass": Scene(panel=Panel(scale=0.25, layout="led"), lens=Lens(olpf=4)),
    "sharp": Scene(panel=Panel(scale=0.05)),
}


@pytest.mark.parametrize("name", SOFT_AND_NEAR)
def test_magnified_screens_under_any_lens_are_near_brute_force(name):
    settings = {"view.roll": 3, "sensor.scale": 2, "sensor.cfa": "none"}
    base = with_values(SOFT_AND_NEAR[name], settings)
    brute = with_values(base, {"sensor.exposure": "supersample:24"})
    shot, white = base.sample(1, (12, 16)), torch.ones(1, 3, 12, 16).double()
    error = expose(white, shot) - expose(white, dataclasses.replace(shot, scene=brute))
    assert error.square().mean().sqrt() < 0.03  # a box for all was off by 0.1 to 0.2


def test_no_noise_of_a_noisy_scene_has_a_gradient():
    scene = Scene(sensor=Sensor(shot_noise=(0, 0.1)))
    shot = scene.sample(1, (4, 4))
    quiet = with_values(shot, {"sensor.shot_noise": torch.zeros(1).double()})
    image = torch.rand(1, 3, 4, 4, requires_grad=True)
    capture(image, quiet).sum().backward()
    assert image.grad.isfinite().all()


EMPTY = "pitch of two, point, nearly folded, most crosstalk, sharpened to the limit, no colour"


@pytest.mark.parametrize("name", EMPTY.split(", "))
def test_an_empty_batch_has_a_gradient(name):
    image = torch.rand(0, 3, 6, 6, requires_grad=True)
    photo = CASES[name].capture(image)
    photo.sum().backward()
    assert photo.shape == image.shape == image.grad.shape


@pytest.mark.parametrize("size", [(24, 3840), (2160, 24)], ids=["as wide", "as high"])
def test_an_image_as_large_as_4k(size):
    """Far from the origin phases still have their digits: in float64 the far end is the same."""
    scene = Scene(panel=Panel(scale=0.9), view=View(yaw=10), lens=SOFT)
    image, shot = torch.rand(1, 3, *size), scene.sample(1, size)
    photo = capture(image, shot)
    assert in_range(photo, image)
    assert (photo - capture(image.double(), shot))[..., -20:, -20:].abs().mean() < 1e-3


def test_deterministic_mode_changes_nothing():
    image, shot = RANDOM, Scene.preset("screen_photo").sample(2, (9, 12))
    plain = capture(image, shot)
    torch.use_deterministic_algorithms(True)
    try:
        assert torch.equal(capture(image, shot), plain)
    finally:
        torch.use_deterministic_algorithms(False)


@pytest.mark.parametrize("scale", [1e4, 0.0], ids=["saturated", "no gradient at all"])
def test_an_attack_survives_any_logits(scale):
    class Net(torch.nn.Module):
        def forward(self, x):
            red, _, blue = x.mean((2, 3)).unbind(1)
            return scale * torch.stack([x.mean((1, 2, 3)), red, -blue], 1)

    image, labels = RANDOM, torch.tensor([0, 1])
    attack = MoireAttack(Net(), scene=Scene(sensor=Sensor(scale=2)), eps=0.1, steps=2)
    result = attack(image, labels)
    assert in_range(result.images, image) and result.noise.isfinite().all()
    # the sign of a zero gradient is zero, and the noise stays where it is
    assert bool(result.noise.any()) == (scale > 0)


@pytest.mark.parametrize("value", [0, 1])
def test_empty_and_full_masks(value):
    from torchvision import tv_tensors

    scene = Scene(view=View(roll=20), lens=SOFT, develop=Develop(registered=False))
    mask = tv_tensors.Mask(torch.full((1, 16, 16), value, dtype=torch.uint8))
    _, moved = transforms.RandomMoire(scene, p=1.0)(torch.rand(3, 16, 16), mask)
    assert moved.shape == mask.shape and set(moved.unique().tolist()) <= {0, value}
    assert bool(moved.any()) == bool(value)
