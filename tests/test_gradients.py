"""Gradients: of image, noise and, through the spectral exposure, of every drawn field of a shot."""

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, capture, expose
from moireaug.scene.by_name import values_of, with_values

SCENES = {
    "spectral": Scene(
        panel=Panel(
            scale=0.9, lit=0.9, lit_x=0.8, lit_y=0.7, pwm=200.0, duty=0.7, phase=0.1, black=0.03,
            glare=0.05, glare_x=0.2, glare_y=-0.3,
        ),
        view=View(yaw=12.0, pitch=-7.0, roll=5.0, zoom=0.95, shift_x=0.02, shift_y=0.01),
        lens=Lens(
            k1=0.03, k2=0.01, blur=0.3, olpf=0.3, vignetting=0.2, motion_x=0.4, motion_y=-0.2
        ),
        sensor=Sensor(
            scale=2.0, crosstalk=0.1, gain=1.7, fill=0.9, shutter=1 / 90, readout=1 / 70,
            read_noise=0.01, shot_noise=0.01,
        ),
        develop=Develop(
            linear_light=True, red=1.1, blue=0.9, saturation=0.7, shoulder=0.4, contrast=-0.3,
            brighten=0.03, chroma_blur=0.6, sharpen=0.3, sharpen_radius=0.7,
        ),
    ),
    "point": Scene(
        panel=Panel(scale=2.0), view=View(roll=10.0), sensor=Sensor(scale=5.0, exposure="point"),
        # off the bounds of the clip, where gradients are one-sided
        develop=Develop(resize="point", brighten=0.2),
    ),
    "supersample": Scene(sensor=Sensor(scale=2.0, exposure="supersample:3")),
}  # fmt: skip


def projected(photo):
    """One number of a photo, along a fixed random direction: gradcheck then needs one backward
    pass."""
    generator = torch.Generator().manual_seed(7)
    return (photo * torch.randn(photo.shape, dtype=photo.dtype, generator=generator)).sum()


@pytest.mark.parametrize("name", SCENES)
def test_image_and_noise(name):
    scene = SCENES[name]
    image = torch.rand(1, 3, 4, 5, dtype=torch.float64) * 0.5 + 0.2
    shot = scene.sample(1, (4, 5))
    noise = torch.zeros(shot.raw_shape(), dtype=torch.float64)
    image.requires_grad_(), noise.requires_grad_()
    assert torch.autograd.gradcheck(
        lambda i, d: projected(capture(i, shot, d)), (image, noise), atol=1e-6, fast_mode=True
    )


SCENES["box"] = with_values(SCENES["spectral"], {"sensor.exposure": "box"})
IN_BINS = {"panel.scale": 1.0, "panel.width": 9.0, "sensor.scale": 1.0, "sensor.pitch": 2.1}
SCENES["binned"] = with_values(SCENES["spectral"], IN_BINS)
# of a file's quality there is no gradient
NONE = ("develop.jpeg", "sensor.shrink", "sensor.crop_x", "sensor.crop_y")  # nor of a crop's place
FIELDS = [field for field in values_of(SCENES["spectral"]) if field not in NONE]
# the panel's size is stated in one way
UNREAD = {
    "spectral": ("panel.width", "sensor.pitch"),
    "box": ("panel.width", "sensor.pitch"),
    "binned": ("panel.scale",),
}
POINTS = 4 * torch.rand(2, 5, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
IMAGES = torch.rand(2, 3, 4, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
IMAGES = IMAGES * 0.5 + 0.2
STEP = 1e-7  # bilinear content has kinks at pixel centres: a small step seldom meets one


def per_photo(shot):
    """One number of each photo of IMAGES, again and again, along a fixed random direction."""
    times, generator = len(shot) // len(IMAGES), torch.Generator().manual_seed(7)
    photos = capture(IMAGES.repeat(times, 1, 1, 1), shot)
    direction = torch.randn(IMAGES.shape, dtype=photos.dtype, generator=generator)
    return (photos * direction.repeat(times, 1, 1, 1)).sum((1, 2, 3))


@pytest.mark.parametrize("name", UNREAD)
def test_every_field_of_a_shot(name):
    """By a shot that has every field changed once, in rows of its own, up and then down."""
    fields = [field for field in FIELDS if field not in UNREAD[name]]
    shot = SCENES[name].sample(2, (4, 5), torch.Generator().manual_seed(5))
    leaves = {field: shot.numbers()[field].clone().requires_grad_() for field in fields}
    total = per_photo(with_values(shot, leaves)).sum()
    gradients = torch.autograd.grad(total, list(leaves.values()))
    many, changed = shot.repeat(2 * len(fields)), {}
    for i, field in enumerate(fields):
        steps = torch.zeros(2, len(fields), 2, dtype=torch.float64)
        steps[0, i], steps[1, i] = STEP, -STEP
        changed[field] = many.numbers()[field] + steps.flatten()
    above, below = per_photo(with_values(many, changed)).reshape(2, len(fields), 2)
    for field, found, numeric in zip(fields, gradients, (above - below) / (2 * STEP), strict=True):
        assert found.abs().min() > 0, field
        assert torch.allclose(found, numeric, rtol=1e-3, atol=1e-4), (field, found, numeric)


@pytest.mark.parametrize("exposure", ["spectral", "box", "mean"])
def test_a_subpixel_amid_an_aperture_moves_with_the_camera(exposure):
    """On a bound `torch.clamp` would stop the gradient: here every sensor pixel looks at a
    subpixel's centre."""
    sensor = Sensor(scale=3.0, cfa="none", exposure=exposure)
    view = View(shift_x=(0.0, 1e-9))  # a pose in the plan, that is hardly one
    scene = Scene(view=view, lens=Lens(blur=0.3), sensor=sensor)
    image = torch.linspace(0.2, 0.8, 5, dtype=torch.float64).square().expand(1, 3, 4, 5)
    shot = scene.sample(1, (4, 5))
    shift = torch.zeros(1, dtype=torch.float64, requires_grad=True)
    raw = expose(image, with_values(shot, {"view.shift_x": shift}))
    for reading in raw[0, :, 6, 6:9].flatten():
        assert torch.autograd.grad(reading, shift, retain_graph=True)[0].isfinite().all()
    (slope,) = torch.autograd.grad(raw.sum(), shift)
    assert slope.abs() > 0.1


FORWARD = {
    **SCENES,
    "turned": Scene(view=View(yaw=12.0, roll=5.0), lens=Lens(k1=0.03), sensor=Sensor(scale=2.0)),
    "far": Scene(view=View(zoom=0.1)),
    "antialias": Scene(sensor=Sensor(scale=1.5), develop=Develop(resize="antialias")),
    "bilateral": Scene(develop=Develop(denoise="bilateral")),
}


@pytest.mark.filterwarnings("ignore:.torch.jit.script:FutureWarning")  # PyTorch's own call
@pytest.mark.parametrize("name", FORWARD)
def test_forward_derivatives_are_those_of_backward(name):
    shot = FORWARD[name].sample(2, (4, 5), torch.Generator().manual_seed(5))
    along = torch.randn(IMAGES.shape, dtype=torch.float64)
    images = IMAGES.clone().requires_grad_()
    expected = capture(images, shot)
    photo, moved = torch.func.jvp(lambda x: capture(x, shot), (IMAGES,), (along,))
    assert torch.allclose(photo, expected, atol=1e-9)
    (slope,) = torch.autograd.grad(projected(expected), images)
    torch.testing.assert_close(projected(moved), (slope * along).sum())


@pytest.mark.filterwarnings("ignore:.torch.jit.script:FutureWarning")
@pytest.mark.parametrize("develop", [Develop(jpeg=80.0), Develop(denoise="nlm")])
def test_a_codecs_derivative_by_torch_func_is_refused_not_zero(develop):
    shot = Scene(develop=develop).sample(2, (4, 5))
    one = torch.func.vmap(lambda image: capture(image[None], shot[:1]))
    with pytest.raises(NotImplementedError, match="has no forward derivative"):
        torch.func.jvp(lambda x: capture(x, shot), (IMAGES,), (torch.ones_like(IMAGES),))
    for photograph in (lambda images: capture(images, shot), one):
        with pytest.raises(NotImplementedError, match=r"has no derivative by torch\.func"):
            torch.func.grad(lambda images, of=photograph: of(images).sum())(IMAGES)


@pytest.mark.filterwarnings("ignore:.torch.jit.script:FutureWarning")
@pytest.mark.parametrize("registered", [False, True])
def test_a_lens_has_the_hessian_as_second_derivative(registered):
    """torch.func.hessian goes forward over backward, and so another way."""
    scene = Scene(
        view=View(fit=False), lens=Lens(k1=(-0.2, 0.3)), develop=Develop(registered=registered),
        sensor=Sensor(cfa="none", exposure="mean"),
    )  # fmt: skip
    shot = scene.sample(2, (4, 5))

    def found(k1):
        bent = with_values(shot, {"lens.k1": k1})
        return capture(IMAGES, bent).square().sum() + bent.to_photo(POINTS).square().sum()

    bend = torch.tensor([-0.1, 0.2], dtype=torch.float64, requires_grad=True)
    (once,) = torch.autograd.grad(found(bend), bend, create_graph=True)
    (twice,) = torch.autograd.grad(once.sum(), bend)
    hessian = torch.func.hessian(found)(bend.detach())
    assert hessian.abs().min(1).values.max() < 1e-9 < hessian.diagonal().abs().min()
    torch.testing.assert_close(twice, hessian.sum(1))
