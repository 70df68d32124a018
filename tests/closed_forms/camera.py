"""Closed forms of the camera: where it looks, light over its sensor, and from raw to photo. A check
asserts them in one dtype."""

import dataclasses
import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, capture, develop, expose
from moireaug.camera.effects.demosaic import DEMOSAICS, demosaic_bilinear, demosaic_malvar
from moireaug.scene.geometry import grids
from moireaug.scene.geometry.lattice import pack, unpack
from moireaug.scene.view import POSES
from tests.closed_forms.common import CLOSE, COLOUR, EVEN, read, sinc

# -- geometry

SHIFT = (-0.1, 0.1)
PLACES = View(
    yaw=(-30, 30), pitch=(-20, 20), roll=(-45, 45), zoom=(0.7, 1.2), shift_x=SHIFT, shift_y=SHIFT
)
BENDS = ((0.0, 0.0), (0.2, 0.0), (-0.15, 0.0), (0.05, 0.1), (0.3, -0.15), (-0.2, 0.05))


def check_round_trip(dtype):
    """Where a photo point looks is shown at that photo point. Coordinates are float64 whatever the
    image's dtype."""
    size, n = (30, 40), 4
    points = grids.grid(*(torch.linspace(0, s, 9, dtype=torch.float64) for s in size))
    corners = points.flatten(1, 2)
    for pose in POSES:
        for k1, k2 in BENDS:
            scene = Scene(view=dataclasses.replace(PLACES, pose=pose), lens=Lens(k1=k1, k2=k2))
            shot = scene.sample(n, size, torch.Generator().manual_seed(1))
            matrix, lens = shot.matrix(), shot.distortion
            seen = grids.photo_to_image(points, torch.linalg.inv(matrix), size, lens).flatten(1, 2)
            back = grids.image_to_photo(seen, matrix, size, lens)
            assert (back - corners).norm(dim=-1).max() < 1e-9
            assert (seen - corners).norm(dim=-1).max() > 1


# -- light over the sensor


def check_bands(dtype):
    """pwm * readout bands from the first row to the last, of depth 2 sinc(duty) |sinc(pwm *
    shutter)|."""
    n, readout = 256, 1 / 50
    cases = (250.0, 1 / 1000, 0.5), (350.0, 1 / 120, 0.3), (1050.0, 1 / 3000, 0.8)
    for pwm, shutter, duty in (*cases, (250.0, 1 / 125, 0.4)):
        sensor = Sensor(scale=2.0, shutter=shutter, readout=readout)
        scene = Scene(panel=Panel(layout="even", pwm=pwm, duty=duty), sensor=sensor)
        raw = read(scene, (n, 1), dtype, level=0.2)
        spectrum, bands = torch.fft.fft(raw[..., 0]) / n, round(pwm * readout)
        depth = 2 * sinc(duty) * abs(sinc(pwm * shutter))
        mean, first = spectrum[:, 0].real, spectrum[:, bands]
        assert mean.tolist() == pytest.approx([0.2] * 4, rel=1e-3)
        assert (2 * first.abs() / mean).tolist() == pytest.approx([depth] * 4, abs=1e-4)
        if depth < 1e-9:
            assert raw.std() < CLOSE[dtype]
            continue
        # the cell's second row exposes one row later
        later = (first[2:] / first[:2]).angle() / (2 * math.pi)
        assert later.tolist() == pytest.approx([bands / (2 * n)] * 2, abs=1e-4)


def check_vignetting(dtype):
    """A ray keeps the fourth power of its cosine of its light: all in the centre, and 1 - loss in
    the corner."""
    h, w = 5, 9
    for scale, loss in ((1, 0.4), (3, 0.99)):  # without colour filters and with
        sensor = Sensor(scale=scale, cfa="none" if scale == 1 else "rggb")
        raw = read(Scene(panel=EVEN, lens=Lens(vignetting=loss), sensor=sensor), (h, w), dtype)
        dark = (raw if scale == 1 else unpack(raw[None]))[0, : h * scale, : w * scale].numpy()
        v, u = ((np.arange(n * scale) + 0.5) / scale - n / 2 for n in (h, w))
        r = np.hypot(v[:, None], u) / math.hypot(h / 2, w / 2)
        # the angle of its ray, whose cosine to the fourth is left
        corner = math.acos((1 - loss) ** 0.25)
        assert np.abs(dark - np.cos(np.arctan(r * math.tan(corner))) ** 4).max() < CLOSE[dtype]
        assert dark[h * scale // 2, w * scale // 2] == 1


# -- from raw to photo


def to_light(codes):
    return np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)


def to_codes(light):
    curve = 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055
    return np.where(light <= 0.0031308, light * 12.92, curve)


def photo_of(mosaic, dtype, size, **parts):
    """The photo of (h, w) raw numbers."""
    shot = Scene(panel=EVEN, **parts).sample(1, size)
    raw = pack(mosaic[None].to(dtype))
    assert raw.shape == shot.raw_shape()
    return develop(raw, shot)[0].double()


def sensor_of(size, scale):
    """Rows and columns of a whole sensor, whose cells are not cut."""
    return [n * scale + n * scale % 2 for n in size]


SIZE = (7, 10)


def ramp(size, scale=1):
    v, u = ((torch.arange(n, dtype=torch.float64) + 0.5) / scale for n in size)
    return 0.1 + 0.05 * v[:, None] + 0.03 * u


def check_demosaic(dtype):
    """A constant stays one up to the border, past which the mosaic is mirrored, and a ramp away
    from it by as much as the filters reach."""
    for demosaic in DEMOSAICS:
        for scale in (1, 2, 3, 4):
            parts = {"sensor": Sensor(scale=scale), "develop": Develop(demosaic=demosaic)}
            size = sensor_of(SIZE, scale)
            flat = torch.full(size, 0.6, dtype=torch.float64)
            assert (photo_of(flat, dtype, SIZE, **parts) - 0.6).abs().max() < CLOSE[dtype]
            photo = photo_of(ramp(size, scale), dtype, SIZE, **parts)
            assert (photo - ramp(SIZE))[:, 2:-2, 2:-2].abs().max() < CLOSE[dtype]


def check_mosaic_to_photo(dtype):
    """Demosaic at every sensor pixel, whose outermost cells go on past the border, and then the
    mean of each window."""
    plain = {"bilinear": demosaic_bilinear, "malvar": demosaic_malvar}
    for demosaic, scale in ((d, s) for d in plain for s in (1, 2, 3, 4)):
        generator = torch.Generator().manual_seed(scale)
        mosaic = torch.rand(sensor_of(SIZE, scale), dtype=torch.float64, generator=generator)
        parts = {"sensor": Sensor(scale=scale), "develop": Develop(demosaic=demosaic)}
        photo = photo_of(mosaic, dtype, SIZE, **parts)
        wide = unpack(F.pad(pack(mosaic[None]), (2, 2, 2, 2), mode="replicate"))
        colour = plain[demosaic](wide)[..., 4 : 4 + SIZE[0] * scale, 4 : 4 + SIZE[1] * scale]
        assert (photo - F.avg_pool2d(colour.clamp(0, 1), scale)[0]).abs().max() < CLOSE[dtype]


# weights of four sensor pixels in a row for the first of two photo pixels
WEIGHTS = {
    "area": (1 / 2, 1 / 2, 0, 0),
    "point": (1 / 2, 1 / 2, 0, 0),
    "antialias": (3 / 7, 3 / 7, 1 / 7, 0),
}


def check_resize_of_codes(dtype):
    """Light becomes codes on the sensor's pixels, and these become photo pixels: a mean of codes,
    not of light."""
    light = torch.tensor([[0.02, 0.9, 0.3, 0.0], [0.6, 0.001, 0.08, 1.0]], dtype=torch.float64)
    codes = to_codes(light.numpy())
    for resize, weights in WEIGHTS.items():
        how = Develop(linear_light=True, resize=resize)
        scene = Scene(panel=EVEN, sensor=Sensor(scale=2.0, cfa="none"), develop=how)
        shot = scene.sample(1, (1, 2))
        photo = develop(light.to(dtype).expand(1, 3, 2, 4), shot)[0, :, 0].double().numpy()
        expected = [codes.mean(0) @ weights, codes.mean(0)[::-1] @ weights]
        assert np.abs(photo - expected).max() < max(1e-5, CLOSE[dtype])
        assert abs(to_codes(light.numpy().mean(0) @ weights) - expected[0]) > 0.05


def shade(dtype):
    """A picture of every level, (1, 3, 1, 101)."""
    return torch.linspace(0, 1, 101, dtype=dtype).expand(1, 3, 1, -1)


def check_gain(dtype):
    """A reading is multiplied by it and ends at a full well."""
    scene = Scene(panel=EVEN, sensor=Sensor(cfa="none", gain=1.7))
    for step in (expose, capture):
        reading = step(shade(dtype), scene.sample(1, (1, 101)))
        assert (reading - (1.7 * shade(dtype)).clamp(max=1)).abs().max() < CLOSE[dtype]


def check_bits(dtype):
    """As many levels as there are, evenly from 0 to 1, and a gradient that passes straight
    through."""
    for bits in (1, 3, 8):
        scene = Scene(panel=EVEN, sensor=Sensor(cfa="none", bits=bits))
        image = shade(dtype).clone().requires_grad_()
        photo = capture(image, scene.sample(1, (1, 101)))
        levels = photo.detach() * (2**bits - 1)
        assert (levels - levels.round()).abs().max() < 300 * CLOSE[dtype]
        assert (photo - image).abs().max() <= 0.5 / (2**bits - 1) + CLOSE[dtype]
        assert len(levels.round().unique()) == min(2**bits, 101)
        (gradient,) = torch.autograd.grad(photo.sum(), image)
        assert (gradient == 1).all()


def check_balance(dtype):
    """White balance multiplies light, and brighten adds to codes."""
    gains = np.array([1.3, 1.0, 0.6])[None, :, None, None]
    for linear in (True, False):
        how = Develop(red=1.3, blue=0.6, brighten=0.05, linear_light=linear)
        codes = shade(torch.float64).numpy()
        expected = to_codes(to_light(codes) * gains) if linear else codes * gains
        shot = Scene(panel=EVEN, sensor=COLOUR, develop=how).sample(1, (1, 101))
        photo = capture(shade(dtype), shot).double().numpy()
        assert np.abs(photo - np.clip(expected + 0.05, 0, 1)).max() < max(1e-5, CLOSE[dtype])


def check_noise_variance(dtype):
    """read^2 + shot^2 * reading, the reading after gain."""
    levels, gain = torch.tensor([0.1, 0.3, 0.6]), 1.4
    for still, lit in ((0.01, 0.0), (0.01, 0.03), (0.0, 0.03)):
        scene = Scene(panel=EVEN, sensor=Sensor(gain=gain, read_noise=still, shot_noise=lit))
        image = levels.to(dtype)[:, None, None, None].expand(3, 3, 160, 160)
        raw = expose(image, scene.sample(3, (160, 160), torch.Generator().manual_seed(2))).double()
        variance = still**2 + lit**2 * gain * levels.double()
        assert raw.mean((1, 2, 3)).tolist() == pytest.approx((gain * levels).tolist(), abs=1e-3)
        assert raw.var((1, 2, 3)).tolist() == pytest.approx(variance.tolist(), rel=0.03)
