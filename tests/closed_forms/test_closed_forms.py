"""The whole chain against closed forms, each with a fault that must make it fail.

Each check runs once in float64 and once in float32. `BROKEN` spoils one effect at a time: the check
that is named beside it must notice.
"""

import inspect
import pkgutil
import sys

import pytest
import torch

pytest.register_assert_rewrite("tests.closed_forms.screen", "tests.closed_forms.camera")

from moireaug.scene.geometry.lattice import pack
from tests.closed_forms import camera, screen

FUNCTIONS = vars(screen) | vars(camera)
CHECKS = [check for name, check in FUNCTIONS.items() if name.startswith("check_")]


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


def one_of_each_window(photo, rows, cols, how):
    return photo[..., :: rows.step, :: cols.step]


def without_gradient(raw, bits):
    return torch.round(raw * (2**bits - 1)) / (2**bits - 1)


def wide(footprint):
    return footprint._replace(box=4 * footprint.box)


def times(factor):
    return lambda x: factor * x


def nearest(mosaic):
    """A demosaic that takes each cell for one pixel."""
    return pack(mosaic)[:, [0, 1, 3]].repeat_interleave(2, 2).repeat_interleave(2, 3)


def every(change):
    """A table whose every function is spoilt."""
    return lambda table: {name: change(f) for name, f in table.items()}


def resized_first(effects):
    """The development with the resize of light, and not of codes."""
    resize = [e for e in effects if e.name == "resize"]
    others = [e for e in effects if e.name != "resize"]
    before = [e.name for e in others].index("encode")
    return (*others[:before], *resize, *others[before:])


CAMERA = "moireaug.camera"
TRANSFER = f"{CAMERA}.exposure.footprint.Optics.transfer"
COEFFICIENT = f"{CAMERA}.exposure.full.coefficient"
INVERSE_LENS = "moireaug.scene.geometry.grids.inverse_radial_factor"
RESIZE, GAIN = (
    f"{CAMERA}.effects.resize.resize",
    f"{CAMERA}.effects.sensor.Gain.__call__",
)
QUANTISE = f"{CAMERA}.effects.sensor.quantise"
ROTATION = "moireaug.scene.geometry.homography._rotation_columns"
FOOTPRINT = f"{CAMERA}.exposure.footprint.Footprint.of"
SHARES = f"{CAMERA}.exposure.axis_views.tap_weights"
PREFILTER = f"{CAMERA}.effects.prefilter.blur_by_pyramid"
DEMOSAICS, FLICKER = (
    f"{CAMERA}.effects.demosaic.DEMOSAICS",
    f"{CAMERA}.effects.light.flicker",
)
FALLOFF, NOISE = (
    f"{CAMERA}.effects.light.falloff",
    f"{CAMERA}.effects.sensor.add_noise",
)
BROKEN = [  # check, where the effect is looked up, how it is spoilt
    (screen.check_alias, TRANSFER, argument("self", optics("blur", 0))),
    (screen.check_alias, TRANSFER, argument("self", optics("olpf", 0.99))),
    (screen.check_alias, TRANSFER, argument("self", optics("fill", 0.999))),
    (screen.check_alias, COEFFICIENT, argument("width", torch.square)),
    (screen.check_alias, ROTATION, argument("roll", torch.neg)),
    (screen.check_whole_pitches, TRANSFER, argument("self", optics("fill", 0.99))),
    (screen.check_whole_pitches, FOOTPRINT, argument("optics", optics("fill", 0.99))),
    (
        screen.check_mean_light,
        f"{CAMERA}.panel.mean_light",
        argument("width", torch.sqrt),
    ),
    (screen.check_mean_light, COEFFICIENT, argument("width", torch.sqrt)),
    (screen.check_mean_light, SHARES, argument("width", times(0.999))),
    (
        screen.check_mean_light,
        f"{CAMERA}.exposure.sampled.emits",
        argument("width", torch.square),
    ),
    (screen.check_box, FOOTPRINT, argument("optics", optics("fill", 0.999))),
    (screen.check_box, SHARES, argument("offset", times(0.999))),
    (screen.check_point, f"{CAMERA}.exposure.sampled._raster", argument("at", times(1.01))),
    (screen.check_supersampling, TRANSFER, argument("self", optics("blur", 0.5))),
    (screen.check_supersampling, FOOTPRINT, argument("optics", optics("fill", 0.8))),
    (screen.check_held_picture, SHARES, argument("footprint", wide)),
    (screen.check_checkerboard_from_afar, PREFILTER, instead(lambda image, *_: image)),
    (screen.check_checkerboard_from_afar, PREFILTER, argument("variance", times(0.01))),
    (camera.check_round_trip, "moireaug.scene.geometry.distortion.NEWTON_STEPS", instead(1)),
    (camera.check_round_trip, INVERSE_LENS, argument("k2", times(1.01))),
    (camera.check_bands, FLICKER, argument("readout", times(2))),
    (camera.check_bands, FLICKER, argument("shutter", times(1.01))),
    (camera.check_bands, FLICKER, argument("duty", times(0.99))),
    (camera.check_bands, FLICKER, argument("rows", lambda rows: rows[::2].repeat_interleave(2))),
    (camera.check_vignetting, FALLOFF, result(torch.sqrt)),
    (camera.check_vignetting, FALLOFF, argument("v", times(1.01))),
    (camera.check_demosaic, DEMOSAICS, every(result(times(0.999)))),
    (camera.check_demosaic, DEMOSAICS, every(instead(nearest))),
    (camera.check_mosaic_to_photo, DEMOSAICS, every(instead(nearest))),
    (camera.check_mosaic_to_photo, RESIZE, instead(one_of_each_window)),
    (camera.check_resize_of_codes, f"{CAMERA}.pipeline.DEVELOP", resized_first),
    (camera.check_resize_of_codes, RESIZE, argument("how", lambda how: "area")),
    (camera.check_gain, f"{CAMERA}.effects.sensor.clip", instead(lambda raw: raw)),
    (camera.check_gain, GAIN, instead(lambda self, raw, shot: raw)),
    (camera.check_bits, QUANTISE, argument("bits", lambda n: n + 1)),
    (camera.check_bits, QUANTISE, instead(without_gradient)),
    (camera.check_balance, f"{CAMERA}.effects.tone.balance", argument("red", times(1.01))),
    (
        camera.check_balance,
        f"{CAMERA}.effects.srgb.light_of_codes",
        instead(lambda x: x**2.2),
    ),
    (camera.check_noise_variance, NOISE, argument("raw", times(1.01))),
    (camera.check_noise_variance, NOISE, argument("photons", times(1.05))),
    (camera.check_noise_variance, NOISE, argument("read", times(1.05))),
]


@pytest.fixture
def remembered_nothing():
    """Plans, kernels and readouts of a spoilt effect must not outlive it, nor those of a sound one
    reach it."""

    def forget():
        for name, module in list(sys.modules.items()):
            if name.startswith("moireaug"):
                for value in list(vars(module).values()):
                    if hasattr(value, "cache_clear"):
                        value.cache_clear()

    forget()
    yield
    forget()


@pytest.mark.parametrize(
    ("check", "path", "spoil"), BROKEN, ids=[f"{c.__name__}-{p}" for c, p, _ in BROKEN]
)
def test_a_broken_effect_is_noticed(check, path, spoil, remembered_nothing, monkeypatch):
    owner, name = path.rpartition(".")[::2]
    owner = pkgutil.resolve_name(owner)
    monkeypatch.setattr(owner, name, spoil(getattr(owner, name)))
    with pytest.raises(AssertionError):
        check(torch.float64)


def test_every_check_can_fail():
    assert {check for check, *_ in BROKEN} == set(CHECKS)
