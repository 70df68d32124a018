"""Random valid scenes, sizes and images: nothing is ever NaN, out of range, of another shape or
different on replay."""

import dataclasses
import json

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from moireaug import Scene, Shot, capture, expose
from moireaug.scene.fields import bounds
from moireaug.scene.layout import LAYOUTS, Layout
from moireaug.scene.parts import PARTS

RED_AND_GREEN = ((0, 0.5, 0.5, 0.3, 0.2, -0.1, 0.6), (1, 1.5, 0.5, 0.5, 0.5, -0.5, 0.5))
SLANTED = Layout((*RED_AND_GREEN, (2, 1, 0, 1, 0, 0, 0.2)), (2, 1))
UPRIGHT = Layout(((0, 0, 0, 0.3, 1), (1, 0.5, 0.2, 1.4, 0.7), (2, 1.5, 0, 2, 1)), (2, 1))
CHOICES = {
    ("panel", "layout"): [*LAYOUTS, UPRIGHT, SLANTED],
    ("view", "pose"): ["camera", "released"],
    ("view", "fit"): [True, False],
    ("sensor", "reading"): ["auto", "full", "binned"],
    ("sensor", "pixels"): [16, 640.0, 1e5],
    ("sensor", "focal"): [0.1, 0.3, 2, 100.0],
    ("sensor", "scale"): [0.25, 0.5, 1.0, 1.5, 2.0, 2.7, 3.0, 5.0],
    ("sensor", "cfa"): ["rggb", "none"],
    ("sensor", "exposure"): ["auto", "spectral", "box", "mean", "point", "supersample:2"],
    ("sensor", "bits"): [None, 1, 8, 16],
    ("develop", "demosaic"): ["bilinear", "malvar"],
    ("develop", "denoise"): [None, "nlm", "bilateral"],
    ("develop", "resize"): ["area", "antialias", "point"],
    ("develop", "registered"): [True, False],
    ("develop", "linear_light"): [True, False],
}
IMAGES = {"random": torch.rand, "black": torch.zeros, "white": torch.ones}


def values(part, field):
    """A field's own value most of the time, else anything that it allows."""
    own = st.just(field.default)
    if not field.metadata:
        return own | st.sampled_from(CHOICES[part, field.name])
    low, high = field.metadata["low"], field.metadata["high"]
    if part == "lens" and field.name in ("k1", "k2"):
        low, high = -0.05, 0.3  # beyond, many are refused
    near = st.floats(max(low, -2.0), min(high, 2.0))
    number = st.floats(low, high) | near | st.sampled_from([low, high])
    return own | own | number | st.tuples(number, number).map(lambda pair: tuple(sorted(pair)))


def built(cls, **given):
    """A part of a scene; the released pose takes whole degrees."""
    if given.get("pose") == "released":
        for angle in ("yaw", "pitch", "roll"):
            ends = [float(round(end)) for end in bounds(given[angle])]
            given[angle] = ends[0] if ends[0] == ends[1] else tuple(ends)
    for name, least in (("pwm", 1.0), ("shutter", 1e-6), ("jpeg", 1.0)):  # off, or on
        if name in given and bounds(given[name])[1]:
            low, high = (max(end, least) for end in bounds(given[name]))
            given[name] = low if low == high else (low, high)
    for stated, least in (("width", 1.0), ("pitch", 1e-3), ("shrink", 0.1)):
        if stated in given and "scale" in given and bounds(given[stated])[1]:
            low, high = (max(end, least) for end in bounds(given[stated]))
            given[stated] = low if low == high else (low, high)
            given["scale"] = 1.0
    return cls(**given)


def a_scene(*, sensor, **parts):
    """A scene; a full reading takes no screen, and a binned one no single sensor pixels."""
    stated = bounds(parts["panel"].width)[1] or bounds(sensor.pitch)[1]
    if bounds(sensor.shrink)[1]:  # with one of the two
        if bounds(sensor.pitch)[1] or not stated:
            parts["panel"] = dataclasses.replace(parts["panel"], width=0.0)
            pitch = tuple(min(max(end, 0.1), 50.0) for end in bounds(sensor.pitch or 1.7))
            sensor = dataclasses.replace(sensor, pitch=pitch)
        else:
            width = tuple(max(end, 900.0) for end in bounds(parts["panel"].width))
            parts["panel"] = dataclasses.replace(parts["panel"], width=width)
        zoom = tuple(min(max(end, 0.1), 50.0) for end in bounds(parts["view"].zoom))
        parts["view"] = dataclasses.replace(parts["view"], zoom=zoom)
        stated = True
    if stated and sensor.reading == "full":
        sensor = dataclasses.replace(sensor, reading="auto")
    if stated or sensor.reading == "binned":
        if sensor.exposure not in ("spectral", "mean"):
            sensor = dataclasses.replace(sensor, exposure="auto")
        parts["view"] = dataclasses.replace(parts["view"], pose="camera")
        plain = {"demosaic": "bilinear", "resize": "area", "denoise": None}
        parts["develop"] = dataclasses.replace(parts["develop"], **plain)
    return Scene(sensor=sensor, **parts)


def a_part(part):
    fields = {f.name: values(part, f) for f in dataclasses.fields(PARTS[part])}
    return st.builds(built, st.just(PARTS[part]), **fields)


SCENES = st.builds(
    a_scene,
    **{part: a_part(part) for part in PARTS},
    tolerance=st.sampled_from([1 / 512, 1 / 512, 1 / 512, 0.0, 1.0]),
)


SLOW = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]


@settings(
    max_examples=9, deadline=None, derandomize=True, database=None, suppress_health_check=SLOW
)
@given(
    scene=SCENES, n=st.integers(0, 2), height=st.integers(1, 9), width=st.integers(1, 9),
    dtype=st.sampled_from([torch.float16, torch.bfloat16, torch.float32, torch.float64]),
    kind=st.sampled_from(sorted(IMAGES)), seed=st.integers(0, 99),
)  # fmt: skip
def test_any_scene_on_any_image(scene, n, height, width, dtype, kind, seed):
    generator = torch.Generator().manual_seed(seed)
    image = IMAGES[kind]((n, 3, height, width)).to(dtype)
    kept = image.clone()
    assert Scene.from_dict(json.loads(json.dumps(scene.to_dict()))) == scene
    if scene.panel.layout == SLANTED and scene.sensor.exposure in ("point", "box"):
        with pytest.raises(ValueError, match="takes subpixels for rectangles"):
            scene.plan()
        return
    assert json.dumps(scene.plan().to_dict()) and str(scene.plan())
    shot = scene.sample(n, (height, width), generator)
    photo = capture(image, shot)
    assert photo.shape == image.shape and photo.dtype == dtype and photo.isfinite().all()
    assert not photo.numel() or (photo.min() >= 0 and photo.max() <= 1)
    assert torch.equal(image, kept)
    replayed = Shot.from_dict(json.loads(json.dumps(shot.to_dict())))
    assert torch.equal(capture(image, replayed), photo)
    assert tuple(expose(image, shot).shape) == shot.raw_shape()

    image = image.double().requires_grad_()
    noise = torch.zeros(shot.raw_shape(), dtype=torch.float64, requires_grad=True)
    for gradient in torch.autograd.grad(capture(image, shot, noise).sum(), (image, noise)):
        assert gradient.isfinite().all()
