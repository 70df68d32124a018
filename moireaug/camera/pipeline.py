"""The path of light: every effect in the order in which light meets it, and the plan of those that
a scene calls for."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import torch
from torch import Tensor

from moireaug.camera.effects.base import Effect, format_range
from moireaug.camera.effects.demosaic import Demosaic
from moireaug.camera.effects.denoise import Denoise
from moireaug.camera.effects.detail import ChromaBlur, ClipDetail, Sharpen
from moireaug.camera.effects.exposure import Crosstalk, Exposure, LensDistortion, PanelLayout, Pose
from moireaug.camera.effects.jpeg import Jpeg
from moireaug.camera.effects.light import BlackLevel, Flicker, Glare, Vignetting
from moireaug.camera.effects.prefilter import Prefilter, max_lost_variance
from moireaug.camera.effects.resize import Register, Resize
from moireaug.camera.effects.sensor import Bits, ClipReading, Gain, Noise, Saturate
from moireaug.camera.effects.srgb import Clip, Decode, Encode
from moireaug.camera.effects.tone import Balance, Brighten, ColourMatrix, ToneCurve
from moireaug.camera.exposure.choose import method_of
from moireaug.common.numeric import as_float
from moireaug.scene.draws import MAX_CACHED_SCENES
from moireaug.scene.fields import bounds
from moireaug.scene.plan import Plan, PlanStep
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord

EXPOSE: tuple[Effect, ...] = (
    Decode(),  # codes to light
    BlackLevel(),
    Prefilter(),  # panel pixels too far away for the exposure's sums
    PanelLayout(),  # the next four are integrated by the exposure
    Pose(),
    LensDistortion(),
    Crosstalk(),
    Exposure(),  # panel light to readings
    Flicker(),  # of the panel, not of the room that its glass reflects
    Glare(),
    Vignetting(),
    Gain(),
    Noise(),
    ClipReading(),
)
DEVELOP: tuple[Effect, ...] = (
    Saturate(),  # of the reading and an attacker's noise
    Bits(),
    Demosaic(),  # readings to colours
    Balance(),
    ColourMatrix(),
    Encode(),  # light to codes
    ToneCurve(),
    Brighten(),
    Clip(),
    Denoise(),
    ChromaBlur(),
    Sharpen(),
    ClipDetail(),
    Resize(),  # sensor pixels to photo pixels
    Register(),  # back to the image's frame
    Jpeg(),
)


def expose(light: Tensor, shot: ShotRecord) -> Tensor:
    """Return the raw reading of images (B, 3, H, W): apply the effects before the attacker's noise
    in turn."""
    return apply(shot.plan.exposing, light, shot)


def develop(raw: Tensor, shot: ShotRecord) -> Tensor:
    """Return the photos (B, 3, H, W) of a raw reading: apply the effects after the attacker's noise
    in turn."""
    return apply(shot.plan.developing, raw, shot)


def apply(names: Sequence[str], values: Tensor, shot: ShotRecord) -> Tensor:
    """Apply the effects of these names in turn, on the values' device; values of uint8 become
    float32.

    Raises:
        KeyError: a name that no effect has.
    """
    effects, values = effects_by_name(), as_float(values)
    if names:
        shot = shot.to(values.device).with_geometry_kept()
    for name in names:
        values = effects[name](values, shot)
    return values


def effects_by_name() -> dict[str, Effect]:
    """Return every effect by its name, in the order in which light meets them."""
    return {effect.name: effect for effect in (*EXPOSE, *DEVELOP)}


def make_plan(scene: SceneRecord) -> Plan:
    """Judge every effect by the ranges of a scene, from `sized.scene_of_size`; see `Scene.plan`.
    Kept: workers send equal scenes again and again."""
    return _make_plan(scene, EXPOSE, DEVELOP)


@functools.lru_cache(maxsize=MAX_CACHED_SCENES)
@torch.no_grad()
def _make_plan(scene: SceneRecord, expose: tuple[Effect, ...], develop: tuple[Effect, ...]) -> Plan:
    verdicts = {effect.name: effect.verdict(scene) for effect in (*expose, *develop)}
    listed = [effect.name for effect in (*expose, *develop) if effect.is_listed]
    return Plan(
        steps=tuple(PlanStep(name, *verdicts[name]) for name in listed),
        exposing=tuple(effect.name for effect in expose if verdicts[effect.name].called),
        developing=tuple(effect.name for effect in develop if verdicts[effect.name].called),
        method=method_of(scene),
        prefilter_variance=max_lost_variance(scene),
        needs_every_pixel=any(e.needs_every_pixel and verdicts[e.name].called for e in develop),
        scales=_scales_of(scene),
    )


def _scales_of(scene: SceneRecord) -> str:
    """Return how many panel and sensor pixels an image pixel gets, in words."""
    panel = format_range(scene.panel.scale)
    if scene.is_crop:
        sensor = format_range(scene.sensor.shrink)
    elif scene.sensor.pitch:
        ends = zip(bounds(scene.panel.scale), bounds(scene.sensor.pitch), strict=True)
        low, high = (scale * pitch for scale, pitch in ends)
        sensor = format_range((low, high))
    else:
        sensor = format_range(scene.sensor.scale)
    return f"An image pixel gets {panel} panel pixels and {sensor} sensor pixels along each axis"


make_plan._torchdynamo_disable = True  # type: ignore[attr-defined]  # torch.compile runs it as it is
