"""The whole chain against closed forms, and beside each what must make it fail.

Each check runs once in float64 and once in float32. `BROKEN` spoils one effect at a time: the check that is named
beside it must notice.
"""

import inspect
import pkgutil
import sys

import pytest
import torch

pytest.register_assert_rewrite("tests.closed_forms.screen", "tests.closed_forms.camera")

from moireaug.effects import bayer
from tests.closed_forms import camera, screen

CHECKS = [f for module in (screen, camera) for name, f in vars(module).items() if name.startswith("check_")]


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
    (screen.check_alias, TRANSFER, argument("self", optics("blur", 0))),
    (screen.check_alias, TRANSFER, argument("self", optics("olpf", 0.99))),
    (screen.check_alias, TRANSFER, argument("self", optics("fill", 0.999))),
    (screen.check_alias, "moireaug.effects.exposure.coefficient", argument("lit", torch.square)),
    (screen.check_alias, "moireaug.effects.view._rotation_columns", argument("roll", torch.neg)),
    (screen.check_whole_pitches, TRANSFER, argument("self", optics("fill", 0.99))),
    (screen.check_whole_pitches, EDGES, argument("optics", optics("fill", 0.99))),
    (screen.check_low_pass_filter, TRANSFER, argument("self", optics("olpf", 0.9))),
    (screen.check_mean_light, "moireaug.integrate.coefficient", argument("lit", torch.sqrt)),
    (screen.check_mean_light, "moireaug.effects.exposure.covered", argument("width", times(0.999))),
    (screen.check_mean_light, "moireaug.effects.exposure.emits", argument("lit", torch.square)),
    (screen.check_box, EDGES, argument("optics", optics("fill", 0.999))),
    (screen.check_box, "moireaug.effects.exposure.covered", argument("q", times(0.999))),
    (screen.check_point, "moireaug.integrate.SAMPLED",
     lambda own: own | {"point": argument("x", times(1.01))(own["point"])}),
    (screen.check_supersampling, TRANSFER, argument("self", optics("blur", 0.5))),
    (screen.check_supersampling, EDGES, argument("optics", optics("fill", 0.8))),
    (screen.check_held_picture, "moireaug.effects.exposure.held", instead(lambda q, *_: q)),
    (screen.check_checkerboard_from_afar, "moireaug.integrate.prefilter", instead(lambda image, *_: image)),
    (screen.check_checkerboard_from_afar, "moireaug.integrate.prefilter", argument("variance", times(0.01))),
    (camera.check_round_trip, "moireaug.effects.view.NEWTON_STEPS", instead(1)),
    (camera.check_round_trip, "moireaug.effects.view.undistortion", argument("k2", times(1.01))),
    (camera.check_bands, FLICKER, argument("readout", times(2))),
    (camera.check_bands, FLICKER, argument("shutter", times(1.01))),
    (camera.check_bands, FLICKER, argument("duty", times(0.99))),
    (camera.check_bands, FLICKER, argument("rows", lambda rows: rows[::2].repeat_interleave(2))),
    (camera.check_vignetting, "moireaug.effects.tone.falloff", result(torch.sqrt)),
    (camera.check_vignetting, "moireaug.effects.tone.falloff", argument("rows", times(1.01))),
    (camera.check_demosaic_of_a_constant, "moireaug.effects.bayer.folded_kernel", result(times(0.999))),
    (camera.check_demosaic_of_a_ramp, DEMOSAICS, instead(dict.fromkeys(bayer.DEMOSAICS, nearest))),
    (camera.check_folded_kernels, DEMOSAICS, instead(dict.fromkeys(bayer.DEMOSAICS, nearest))),
    (camera.check_folded_kernels, "moireaug.effects.bayer.reduce_window",
     instead(lambda colour, step, *_: colour[..., ::step, ::step])),
    (camera.check_gain, "moireaug.effects.tone.clip", instead(lambda raw: raw)),
    (camera.check_gain, "moireaug.capture._attenuate", instead(lambda raw, *_: raw)),
    (camera.check_bits, "moireaug.effects.noise.quantise", argument("bits", lambda n: n + 1)),
    (camera.check_bits, "moireaug.effects.noise.quantise",
     instead(lambda raw, bits: torch.round(raw * (2**bits - 1)) / (2**bits - 1))),
    (camera.check_balance, "moireaug.effects.tone.balance", argument("red", times(1.01))),
    (camera.check_balance, "moireaug.effects.tone.decode", instead(lambda x: x**2.2)),
    (camera.check_noise_variance, "moireaug.effects.noise.sensor_noise", argument("raw", times(1.01))),
    (camera.check_noise_variance, "moireaug.effects.noise.sensor_noise", argument("shot", times(1.05))),
    (camera.check_noise_variance, "moireaug.effects.noise.read_noise", argument("read", times(1.05))),
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
