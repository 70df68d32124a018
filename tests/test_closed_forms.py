"""The whole chain against closed forms, and beside each what must make it fail.

A check asserts closed forms, once in float64 and once in float32. `BROKEN` spoils one effect at a time: the check that
is named beside it must notice.
"""

import dataclasses
import functools
import inspect
import math
import pkgutil
import sys

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, capture, develop, expose
from moireaug.effects import bayer, view
from moireaug.effects.panel import LAYOUTS, Layout, as_layout

EVEN, COLOUR = Panel(layout="even"), Sensor(cfa="none")  # with these a photo is its image
CELL = Layout(((0, 0.0, 0.0, 0.5, 1.0), (1, 0.5, 0.0, 1.0, 0.4), (2, 1.25, 0.5, 1.75, 1.0)), (2, 1))
STEEP = math.degrees(math.atan(3 / 4))  # of cosine 4/5 and sine 3/5
CLOSE = {torch.float64: 1e-11, torch.float32: 1e-6}


def sinc(x):
    return float(np.sinc(x))


def read(scene, size, dtype, level=1.0):
    """The raw reading of a flat screen (planes, h, w), in float64."""
    return expose(torch.full((1, 3, *size), level, dtype=dtype), scene.sample(1, size))[0].double()


def red_spectrum(scene, n, dtype):
    """Fourier coefficients of the red plane that n x n white pixels give, frequencies along v first."""
    return torch.fft.fft2(read(scene, (n, n), dtype)[0]) / n**2


# -- moiré


def check_alias(dtype):
    """Harmonic (k, l) of the panel shows at J^T (k, l), folded to the red pixels' lattice, with |a| times the MTF."""
    n, fill, blur, olpf, side, close = 64, 0.8, 0.08, 0.3, 0.9, CLOSE[dtype] / 10
    red = {  # width and height of the red subpixel, and some harmonics
        "rgb_stripe": (1 / 3, 1, ((1, 0), (2, 0), (4, 0))),
        "rgb_column": (1, 1 / 3, ((0, 1), (0, 2), (0, 4))),
        "led": (1 / 2, 1 / 6, ((1, 0), (0, 1), (1, -1))),
    }
    turns = (
        (View(), 1.0, 0.0),
        (View(roll=STEEP, fit=False), 0.8, 0.6),
        (View(roll=-STEEP, zoom=1.25, fit=False), 0.8, -0.6),
    )
    sensor, lens = Sensor(scale=2.0, fill=fill, exposure="spectral"), Lens(blur=blur, olpf=olpf)
    for layout, (w, h, harmonics) in red.items():
        for turn, c, s in turns:
            panel = Panel(layout=layout, lit=side**2, scale=95 / n * turn.zoom)
            spectrum = red_spectrum(Scene(panel=panel, view=turn, lens=lens, sensor=sensor, tolerance=1e-5), n, dtype)
            for k, l in harmonics:
                across, down = 95 * (c * k + s * l), 95 * (c * l - s * k)  # cycles over n red pixels: whole
                fu, fv = across / (2 * n), down / (2 * n)  # cycles per sensor pixel
                a = w * h * side**2 * sinc(k * w * side) * sinc(l * h * side)
                mtf = sinc(fill * fu) * sinc(fill * fv) * math.exp(-2 * (math.pi * blur) ** 2 * (fu * fu + fv * fv))
                mtf *= math.cos(math.pi * olpf * fu) * math.cos(math.pi * olpf * fv)
                assert abs(a * mtf) > 50 * close
                assert abs(spectrum[round(down) % n, round(across) % n].abs() - abs(a * mtf)) < close


def check_whole_pitches(dtype):
    """An aperture as wide as a whole number of pitches sees no contrast."""
    for exposure in ("spectral", "box"):
        for alpha, fill, whole in ((2.5, 0.8, True), (4.5, 8 / 9, True), (2.5, 0.7, False), (4.5, 1.0, False)):
            sensor = Sensor(scale=2.0, fill=fill, exposure=exposure)
            contrast = read(Scene(panel=Panel(scale=alpha), sensor=sensor, tolerance=1e-7), (2, 63), dtype)[0].std()
            assert contrast < CLOSE[dtype] if whole else contrast > 1e-3


def check_low_pass_filter(dtype):
    """One that parts its pictures by half a pitch removes the first harmonic and leaves the second."""
    n = 64
    for share, gone in ((1 / 2, True), (1 / 3, False)):  # of the pitch, 2 n / 95 sensor pixels
        lens, sensor = Lens(olpf=share * 2 * n / 95), Sensor(scale=2.0, exposure="spectral")
        scene = Scene(panel=Panel(scale=95 / n), lens=lens, sensor=sensor, tolerance=1e-7)
        first, second = (red_spectrum(scene, n, dtype)[0, 95 * k % n].abs() for k in (1, 2))
        assert first < CLOSE[dtype] if gone else first > 0.01
        assert second > 0.01


def check_mean_light(dtype):
    """Over all phases of the panel, 63 along each axis. Points do not integrate, so `point` has no such form."""
    methods = {"mean": 1e-5, "spectral": 1e-5, "box": 1e-5, "supersample:4": 0.02}
    for layout in (*LAYOUTS, CELL):
        cell = as_layout(layout)
        area = [sum(s.width[0] * s.width[1] for s in cell.of(c)) / math.prod(cell.period) for c in bayer.CHANNELS]
        for lit in (1.0, 0.6):
            for method, bound in methods.items():
                panel, sensor = Panel(layout=layout, lit=lit, scale=92 / 63), Sensor(scale=2.0, exposure=method)
                mean = read(Scene(panel=panel, sensor=sensor), (63, 63), dtype).mean((1, 2))
                assert mean.tolist() == pytest.approx([lit * a for a in area], rel=bound)


def overlap(centre, reach, start, width, period):
    """How much of [centre - reach, centre + reach] lies in the copies of [start, start + width], one each period."""
    left = start + period * np.arange(-200, 200)
    low, high = np.maximum(centre[:, None] - reach, left), np.minimum(centre[:, None] + reach, left + width)
    return np.clip(high - low, 0, None).sum(1)


def check_box(dtype):
    """Frontal and sharp, a reading is the exact overlap of subpixels and aperture."""
    size, scale, fill, lit = (8, 12), 3.0, 0.9, 0.7
    for layout in (*LAYOUTS, CELL):
        for alpha in (0.31, 1.7):
            panel, sensor = Panel(layout=layout, lit=lit, scale=alpha), Sensor(scale=scale, fill=fill, exposure="box")
            raw = read(Scene(panel=panel, sensor=sensor, tolerance=1e-6), size, dtype)
            centres = [(np.arange(n * scale) + 0.5) * alpha / scale for n in size]  # of sensor pixels, on the panel
            reach, cell = fill / 2 * alpha / scale, as_layout(layout)
            for plane, (r, c), channel in zip(raw, bayer.CELL, bayer.CHANNELS, strict=True):
                light = 0
                for s in cell.of(channel):
                    sides = [(o - w * lit**0.5 / 2, w * lit**0.5) for o, w in zip(s.centre, s.width, strict=True)]
                    down = overlap(centres[0], reach, *sides[1], cell.period[1])[r::2]
                    across = overlap(centres[1], reach, *sides[0], cell.period[0])[c::2]
                    light = light + down[:, None] * across / (2 * reach) ** 2
                assert np.abs(plane.numpy() - light).max() < 1e-6


def check_point(dtype):
    """A reading is bilinear in a raster of subpixels, as few as their edges allow and each of one value."""
    n, scale, lit = 8, 2.5, 0.6
    for layout in (*LAYOUTS, CELL):
        for alpha in (1.3, 4.0):
            panel, sensor = Panel(layout=layout, lit=lit, scale=alpha), Sensor(scale=scale, exposure="point")
            raw, cell = read(Scene(panel=panel, sensor=sensor, tolerance=1e-6), (n, n), dtype), as_layout(layout)
            at = ((np.arange(n * scale) + 0.5) * alpha / scale) * cell.raster - 0.5  # of sensor pixels, on the raster
            left, height, width = np.floor(at).astype(int), *(cell.raster * p for p in cell.period[::-1])
            for plane, (r, c), channel in zip(raw, bayer.CELL, bayer.CHANNELS, strict=True):
                raster = np.zeros((height, width))
                for s in cell.of(channel):
                    x0, y0, x1, y1 = (round(v * cell.raster) for v in (s.x0, s.y0, s.x1, s.y1))
                    raster[y0:y1, x0:x1] = 1
                light = 0
                for y, x in np.ndindex(2, 2):
                    down, across = (np.abs(1 - k - (at - left))[i::2] for k, i in ((y, r), (x, c)))
                    cells = np.ix_((left[r::2] + y) % height, (left[c::2] + x) % width)
                    light = light + np.outer(down, across) * raster[cells]
                assert np.abs(plane.numpy() - lit * light).max() < 1e-6


MAGNIFIED = Scene(panel=Panel(scale=0.3, layout="pentile", lit=0.8), sensor=Sensor(scale=2.0), tolerance=1e-4)
MINIFIED = dataclasses.replace(MAGNIFIED, panel=Panel(scale=1.3, layout=CELL, lit=0.8))


def from_everywhere(scene, exposure, dtype):
    """The raw reading of six flat screens, seen from six places through bent and blurred lenses."""
    scene = dataclasses.replace(
        scene, view=View(yaw=(-25, 25), pitch=(-10, 10), roll=(-30, 30)), lens=Lens(blur=0.25, olpf=0.4, k1=(0, 0.05)),
        sensor=Sensor(scale=2.0, exposure=exposure),
    )  # fmt: skip
    shot = scene.sample(6, (8, 8), torch.Generator().manual_seed(0))
    return expose(torch.full((6, 3, 8, 8), 0.7, dtype=dtype), shot).double()


@functools.cache
def brute_force(scene, n):
    return from_everywhere(scene, f"supersample:{n}", torch.float64)


def check_supersampling(dtype):
    """Spectral is exact in any view; box, for magnified screens, to the Gaussian that stands for what is not a box."""
    for method, scene, bound, gain in (("spectral", MINIFIED, 0.02, 10), ("box", MAGNIFIED, 0.015, 2)):
        ours = from_everywhere(scene, method, dtype)
        coarse, fine = ((ours - brute_force(scene, n)).square().mean().sqrt() / ours.max() for n in (4, 32))
        assert fine < bound and fine < coarse / gain


# -- the picture


def check_held_picture(dtype):
    """Six sensor pixels a panel pixel, two a stripe: every other reading of a colour lies wholly inside a subpixel."""
    own = (0, 0, 3), (1, 1, 4), (2, 1, 4), (3, 2, 5)  # plane, and where the left and the right panel pixel are read
    for exposure in ("spectral", "box", "supersample:3"):
        scene = Scene(sensor=Sensor(scale=6.0, exposure=exposure))
        pictures = torch.tensor([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], dtype=dtype)[:, None, None].expand(-1, 3, 4, -1)
        left, right, both = expose(pictures, scene.sample(3, (4, 2)))
        for plane, a, b in own:
            assert torch.equal(left[plane, :, a], both[plane, :, a]) and (left[plane, :, b] == 0).all()
            assert torch.equal(right[plane, :, b], both[plane, :, b]) and (right[plane, :, a] == 0).all()
            assert (both[plane, :, [a, b]] - 1).abs().max() < 0.02  # the series is cut at the tolerance


FAR = (  # one reading spans more than 8 image pixels everywhere, or at the far end
    View(zoom=0.1, fit=False),
    View(zoom=0.1, roll=30.0, fit=False),
    View(yaw=60.0, zoom=0.25, fov=60.0, fit=False),
)


def check_checkerboard_from_afar(dtype):
    """Squares of one pixel, eight and more to a reading, are grey: no alias."""
    n = 127  # odd, so that no halving of the picture has each window on as many black as white squares
    board = (torch.arange(n)[:, None] + torch.arange(n)) % 2
    for exposure in ("spectral", "box", "mean"):
        for turn in FAR:
            sensor = Sensor(cfa="none", exposure=exposure)
            scene = Scene(panel=EVEN, view=turn, sensor=sensor, develop=Develop(registered=False))
            shot = scene.sample(1, (n, n))
            raw = expose(board.to(dtype).expand(1, 3, n, n), shot)[0]
            inverse, lines = torch.linalg.inv(shot.matrix()), shot.readouts()[0].positions()
            x, y = view.look(inverse, lines, lines, (n, n), affine=False, lens=None)
            span = view.jacobian(inverse, view.lattice(lines, lines), (n, n), lens=None).norm(dim=-1).amax(-1)
            far = ((x.sub(n / 2).abs() < 48) & (y.sub(n / 2).abs() < 48) & (span > 8))[0]
            assert far.sum() > 50
            assert (raw[:, far] - 0.5).abs().max() < 0.02


# -- geometry

PLACES = View(yaw=(-30, 30), pitch=(-20, 20), roll=(-45, 45), zoom=(0.7, 1.2), shift_x=(-0.1, 0.1), shift_y=(-0.1, 0.1))
BENDS = ((0.0, 0.0), (0.2, 0.0), (-0.15, 0.0), (0.05, 0.1), (0.3, -0.15), (-0.2, 0.05))


def check_round_trip(dtype):
    """Where a photo point looks is shown at that photo point."""
    size, n = (30, 40), 8
    lines = [torch.linspace(0, s, 9, dtype=dtype) for s in size]
    corners = view.lattice(*lines).flatten(1, 2).double()
    for pose in view.POSES:
        for k1, k2 in BENDS:
            scene = Scene(view=dataclasses.replace(PLACES, pose=pose), lens=Lens(k1=k1, k2=k2))
            shot = scene.sample(n, size, torch.Generator().manual_seed(1))
            inverse = torch.linalg.inv(shot.matrix())
            seen = torch.stack(view.look(inverse, *lines, size, affine=False, lens=shot.bends), -1).flatten(1, 2)
            back = view.image_to_photo(seen.double(), shot.matrix(), size, shot.bends)
            assert (back - corners).norm(dim=-1).max() < {torch.float64: 1e-9, torch.float32: 1e-3}[dtype]
            assert (seen - corners).norm(dim=-1).max() > 1


# -- light over the sensor


def check_bands(dtype):
    """pwm * readout bands from the first row to the last, of depth 2 sinc(duty) |sinc(pwm * shutter)|."""
    n, readout = 256, 1 / 50
    cases = (250.0, 1 / 1000, 0.5), (350.0, 1 / 120, 0.3), (1050.0, 1 / 3000, 0.8), (250.0, 1 / 125, 0.4)
    for pwm, shutter, duty in cases:
        sensor = Sensor(scale=2.0, shutter=shutter, readout=readout)
        raw = read(Scene(panel=Panel(layout="even", pwm=pwm, duty=duty), sensor=sensor), (n, 1), dtype, level=0.2)
        spectrum, bands = torch.fft.fft(raw[..., 0]) / n, round(pwm * readout)
        depth = 2 * sinc(duty) * abs(sinc(pwm * shutter))
        mean, first = spectrum[:, 0].real, spectrum[:, bands]
        assert mean.tolist() == pytest.approx([0.2] * 4, rel=1e-3)
        assert (2 * first.abs() / mean).tolist() == pytest.approx([depth] * 4, abs=1e-4)
        if depth < 1e-9:
            assert raw.std() < CLOSE[dtype]
            continue
        later = (first[2:] / first[:2]).angle() / (2 * math.pi)  # the cell's second row exposes one row later
        assert later.tolist() == pytest.approx([bands / (2 * n)] * 2, abs=1e-4)


def check_vignetting(dtype):
    """Of a ray's light its cosine to the fourth is left: 1 in the centre, and in the corner all but its loss."""
    (h, w), loss = (5, 9), 0.4
    for scale in (1, 3):  # without colour filters and with
        sensor = Sensor(scale=scale, cfa="none" if scale == 1 else "rggb")
        raw = read(Scene(panel=EVEN, lens=Lens(vignetting=loss), sensor=sensor), (h, w), dtype)
        dark = (raw if scale == 1 else bayer.unpack(raw[None]))[0, : h * scale, : w * scale].numpy()
        v, u = ((np.arange(n * scale) + 0.5) / scale - n / 2 for n in (h, w))
        r = np.hypot(v[:, None], u) / math.hypot(h / 2, w / 2)
        corner = math.acos((1 - loss) ** 0.25)  # the angle of its ray, whose cosine to the fourth is left
        assert np.abs(dark - np.cos(np.arctan(r * math.tan(corner))) ** 4).max() < CLOSE[dtype]
        assert dark[h * scale // 2, w * scale // 2] == 1


# -- from raw to photo


def photo_of(mosaic, dtype, size, **parts):
    """The photo of (h, w) raw numbers."""
    shot = Scene(panel=EVEN, **parts).sample(1, size)
    raw = bayer.pack(mosaic[None].to(dtype))
    assert raw.shape == shot.raw_shape()
    return develop(raw, shot)[0].double()


def sensor_of(size, scale):
    """Rows and columns of a whole sensor, whose cells are not cut."""
    return [n * scale + n * scale % 2 for n in size]


SIZE = (7, 10)


def check_demosaic_of_a_constant(dtype):
    """Up to the border, past which the mosaic is mirrored."""
    for demosaic in bayer.DEMOSAICS:
        for scale in (1, 2, 3, 4):
            flat = torch.full(sensor_of(SIZE, scale), 0.6, dtype=torch.float64)
            parts = {"sensor": Sensor(scale=scale), "develop": Develop(demosaic=demosaic)}
            assert (photo_of(flat, dtype, SIZE, **parts) - 0.6).abs().max() < CLOSE[dtype]


def check_demosaic_of_a_ramp(dtype):
    """Away from the border by as much as the filters reach."""
    for demosaic in bayer.DEMOSAICS:
        for scale in (1, 2, 3, 4):
            v, u = ((torch.arange(n, dtype=torch.float64) + 0.5) / scale for n in sensor_of(SIZE, scale))
            parts = {"sensor": Sensor(scale=scale), "develop": Develop(demosaic=demosaic)}
            photo = photo_of(0.1 + 0.05 * v[:, None] + 0.03 * u, dtype, SIZE, **parts)
            v, u = (torch.arange(n, dtype=torch.float64) + 0.5 for n in SIZE)
            ramp = 0.1 + 0.05 * v[:, None] + 0.03 * u
            assert (photo - ramp)[:, 2:-2, 2:-2].abs().max() < CLOSE[dtype]


def check_folded_kernels(dtype):
    """One convolution of the packed planes does what demosaic and area resize do one after another."""
    plain = {"bilinear": bayer.demosaic_bilinear, "malvar": bayer.demosaic_malvar}
    for demosaic, scale in ((d, s) for d in plain for s in (1, 2, 3, 4)):
        h, w = sensor_of(SIZE, scale)
        mosaic = torch.rand(h, w, dtype=torch.float64, generator=torch.Generator().manual_seed(scale))
        parts = {"sensor": Sensor(scale=scale), "develop": Develop(demosaic=demosaic)}
        photo = photo_of(mosaic, dtype, SIZE, **parts)
        wide = bayer.unpack(F.pad(bayer.pack(mosaic[None]), (2, 2, 2, 2), mode="replicate"))
        colour = plain[demosaic](wide)[..., 4 : 4 + SIZE[0] * scale, 4 : 4 + SIZE[1] * scale]
        assert (photo - F.avg_pool2d(colour, scale)[0].clamp(0, 1)).abs().max() < CLOSE[dtype]


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
    """As many levels as there are, evenly from 0 to 1, and a gradient that passes straight through."""
    for bits in (1, 3, 8):
        scene, image = Scene(panel=EVEN, sensor=Sensor(cfa="none", bits=bits)), shade(dtype).clone().requires_grad_()
        photo = capture(image, scene.sample(1, (1, 101)))
        levels = photo.detach() * (2**bits - 1)
        assert (levels - levels.round()).abs().max() < 300 * CLOSE[dtype]
        assert (photo - image).abs().max() <= 0.5 / (2**bits - 1) + CLOSE[dtype]
        assert len(levels.round().unique()) == min(2**bits, 101)
        (gradient,) = torch.autograd.grad(photo.sum(), image)
        assert (gradient == 1).all()


def check_balance(dtype):
    """White balance multiplies light, and brighten adds to codes."""

    def to_light(codes):
        return np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)

    def to_codes(light):
        return np.where(light <= 0.0031308, light * 12.92, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)

    gains = np.array([1.3, 1.0, 0.6])[None, :, None, None]
    for linear in (True, False):
        how, codes = Develop(red=1.3, blue=0.6, brighten=0.05, linear_light=linear), shade(torch.float64).numpy()
        expected = to_codes(to_light(codes) * gains) if linear else codes * gains
        shot = Scene(panel=EVEN, sensor=COLOUR, develop=how).sample(1, (1, 101))
        photo = capture(shade(dtype), shot).double().numpy()
        assert np.abs(photo - np.clip(expected + 0.05, 0, 1)).max() < max(1e-5, CLOSE[dtype])


def check_noise_variance(dtype):
    """read^2 + shot^2 * reading, the reading after gain."""
    levels, read_noise, shot_noise, gain = torch.tensor([0.1, 0.3, 0.6]), 0.01, 0.03, 1.4
    for read, shot in ((read_noise, 0.0), (read_noise, shot_noise), (0.0, shot_noise)):
        scene = Scene(panel=EVEN, sensor=Sensor(gain=gain, read_noise=read, shot_noise=shot))
        image = levels.to(dtype)[:, None, None, None].expand(3, 3, 160, 160)
        raw = expose(image, scene.sample(3, (160, 160), torch.Generator().manual_seed(2))).double()
        variance = read**2 + shot**2 * gain * levels.double()
        assert raw.mean((1, 2, 3)).tolist() == pytest.approx((gain * levels).tolist(), abs=1e-3)
        assert raw.var((1, 2, 3)).tolist() == pytest.approx(variance.tolist(), rel=0.03)


CHECKS = [f for name, f in list(globals().items()) if name.startswith("check_")]


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32], ids=["float64", "float32"])
@pytest.mark.parametrize("check", CHECKS, ids=lambda f: f.__name__)
def test_closed_forms(check, dtype):
    check(dtype)


# -- what must be noticed


def argument(name, change):
    """A function that is given something else."""

    def spoil(original):
        def broken(*args, **kwargs):
            given = inspect.signature(original).bind(*args, **kwargs)
            given.arguments[name] = change(given.arguments[name])
            return original(*given.args, **given.kwargs)

        return broken

    return spoil


def result(change):
    """A function that returns something else."""
    return lambda original: lambda *args, **kwargs: change(original(*args, **kwargs))


def instead(other):
    """Something else altogether."""
    return lambda original: other


def optics(name, factor):
    return lambda o: o._replace(**{name: factor * getattr(o, name)})


def times(factor):
    return lambda x: factor * x


def nearest(mosaic):
    """A demosaic that takes each cell for one pixel."""
    return bayer.pack(mosaic)[:, [0, 1, 3]].repeat_interleave(2, 2).repeat_interleave(2, 3)


TRANSFER, EDGES = "moireaug.effects.exposure.Optics.transfer", "moireaug.effects.exposure.edges"
DEMOSAICS, FLICKER = "moireaug.effects.bayer.DEMOSAICS", "moireaug.capture.flicker"
BROKEN = [  # check, where the effect is looked up, how it is spoilt
    (check_alias, TRANSFER, argument("self", optics("blur", 0))),
    (check_alias, TRANSFER, argument("self", optics("olpf", 0.99))),
    (check_alias, TRANSFER, argument("self", optics("fill", 0.999))),
    (check_alias, "moireaug.effects.exposure.coefficient", argument("lit", torch.square)),
    (check_alias, "moireaug.effects.view._rotation_columns", argument("roll", torch.neg)),
    (check_whole_pitches, TRANSFER, argument("self", optics("fill", 0.99))),
    (check_whole_pitches, EDGES, argument("optics", optics("fill", 0.99))),
    (check_low_pass_filter, TRANSFER, argument("self", optics("olpf", 0.9))),
    (check_mean_light, "moireaug.integrate.coefficient", argument("lit", torch.sqrt)),
    (check_mean_light, "moireaug.effects.exposure.covered", argument("width", times(0.999))),
    (check_mean_light, "moireaug.effects.exposure.emits", argument("lit", torch.square)),
    (check_box, EDGES, argument("optics", optics("fill", 0.999))),
    (check_box, "moireaug.effects.exposure.covered", argument("q", times(0.999))),
    (check_point, "moireaug.integrate.SAMPLED", lambda own: own | {"point": argument("x", times(1.01))(own["point"])}),
    (check_supersampling, TRANSFER, argument("self", optics("blur", 0.5))),
    (check_supersampling, EDGES, argument("optics", optics("fill", 0.8))),
    (check_held_picture, "moireaug.effects.exposure.held", instead(lambda q, *_: q)),
    (check_checkerboard_from_afar, "moireaug.integrate.prefilter", instead(lambda image, *_: image)),
    (check_checkerboard_from_afar, "moireaug.integrate.prefilter", argument("variance", times(0.01))),
    (check_round_trip, "moireaug.effects.view.NEWTON_STEPS", instead(1)),
    (check_round_trip, "moireaug.effects.view.undistortion", argument("k2", times(1.01))),
    (check_bands, FLICKER, argument("readout", times(2))),
    (check_bands, FLICKER, argument("shutter", times(1.01))),
    (check_bands, FLICKER, argument("duty", times(0.99))),
    (check_bands, FLICKER, argument("rows", lambda rows: rows[::2].repeat_interleave(2))),
    (check_vignetting, "moireaug.effects.tone.falloff", result(torch.sqrt)),
    (check_vignetting, "moireaug.effects.tone.falloff", argument("rows", times(1.01))),
    (check_demosaic_of_a_constant, "moireaug.effects.bayer.folded_kernel", result(times(0.999))),
    (check_demosaic_of_a_ramp, DEMOSAICS, instead(dict.fromkeys(bayer.DEMOSAICS, nearest))),
    (check_folded_kernels, DEMOSAICS, instead(dict.fromkeys(bayer.DEMOSAICS, nearest))),
    (check_folded_kernels, "moireaug.effects.bayer.reduce_window",
     instead(lambda colour, step, *_: colour[..., ::step, ::step])),
    (check_gain, "moireaug.effects.tone.clip", instead(lambda raw: raw)),
    (check_gain, "moireaug.capture._attenuate", instead(lambda raw, *_: raw)),
    (check_bits, "moireaug.effects.noise.quantise", argument("bits", lambda n: n + 1)),
    (check_bits, "moireaug.effects.noise.quantise",
     instead(lambda raw, bits: torch.round(raw * (2**bits - 1)) / (2**bits - 1))),
    (check_balance, "moireaug.effects.tone.balance", argument("red", times(1.01))),
    (check_balance, "moireaug.effects.tone.decode", instead(lambda x: x**2.2)),
    (check_noise_variance, "moireaug.effects.noise.sensor_noise", argument("raw", times(1.01))),
    (check_noise_variance, "moireaug.effects.noise.sensor_noise", argument("shot", times(1.05))),
    (check_noise_variance, "moireaug.effects.noise.read_noise", argument("read", times(1.05))),
]  # fmt: skip


@pytest.fixture
def remembered_nothing():
    """Plans, kernels and readouts of a spoilt effect must not outlive it, nor those of a sound one reach it."""

    def forget():
        for name, module in list(sys.modules.items()):
            if name.startswith("moireaug"):
                for value in list(vars(module).values()):
                    if hasattr(value, "cache_clear"):
                        value.cache_clear()

    forget()
    yield
    forget()


@pytest.mark.parametrize(("check", "path", "spoil"), BROKEN, ids=[f"{c.__name__}-{p}" for c, p, _ in BROKEN])
def test_a_broken_effect_is_noticed(check, path, spoil, remembered_nothing, monkeypatch):
    owner, name = path.rpartition(".")[::2]
    owner = pkgutil.resolve_name(owner)
    monkeypatch.setattr(owner, name, spoil(getattr(owner, name)))
    with pytest.raises(AssertionError):
        check(torch.float64)


def test_every_check_can_fail():
    assert {check for check, *_ in BROKEN} == set(CHECKS)
