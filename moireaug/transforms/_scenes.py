"""Scenes as transforms take them: planned when a transform is made, described in its `repr`, and
warned about where their photos show no moiré."""

from __future__ import annotations

import contextlib
import functools
import logging
from collections.abc import Sequence
from numbers import Real

import torch

from moireaug.mixtures import Mixture, SceneLike, as_scenes, preset_name, scenes_of
from moireaug.scene.presets import MIXTURES
from moireaug.scene.sized import size_octave
from moireaug.scenes import Scene

NO_MOIRE_MESSAGE = (
    "images of {} x {} pixels are taken for whole photos of {}: half of them show {:.1f} codes of "
    "moiré or less, nine of ten {:.1f}, because shrinking a photo averages it away. If yours are "
    "parts of larger photos, say so: shrink=(1, 3), sensor pixels per image pixel."
)
MIN_MEDIAN_MOIRE = 0.2  # codes, below which half of the photos are taken to have none
logger = logging.getLogger("moireaug")
_checked_octaves: set[tuple[Scene | Mixture, tuple[int, ...]]] = set()


def planned_scenes(
    scene: SceneLike, shrink: float | Sequence[float] | None = None
) -> Scene | Mixture:
    """Return `as_scenes(scene, shrink)`, planned: a scene that cannot be photographed is refused
    when a transform is made, as is a number, which is taken for a probability."""
    if isinstance(scene, Real) and not isinstance(scene, bool):
        raise TypeError(
            f"scene must be a Scene, a preset's name or a dict, or a list of these; got {scene!r}. "
            f"For a probability, pass p={scene!r}."
        )
    scenes = as_scenes(scene, shrink)
    scenes.plan_effects()
    return scenes


def warn_without_moire(scene: Scene | Mixture, size: tuple[int, int]) -> None:
    """Log that nine of ten photos of `size` (height, width) will have less than a code of moiré, or
    half of them none, and what to do. Of each scene and octave of sizes, the first is judged.
    torch.compile leaves it out."""
    if torch.compiler.is_compiling() or min(size) < 1:  # which is refused where it is sampled
        return
    scenes = scenes_of(scene)
    octaves = tuple(size_octave(one, size) for one in scenes)
    if (scene, octaves) in _checked_octaves:
        return
    _checked_octaves.add((scene, octaves))
    expected = [one.expected_moire(size) for one in scenes if one.shows_pattern]
    moire = [one for one in expected if one is not None]
    if moire and len(moire) == len(expected):
        median, high = max(one.median for one in moire), max(one.high for one in moire)
        if high < 1 or median < MIN_MEDIAN_MOIRE:
            logger.warning(NO_MOIRE_MESSAGE.format(*size, describe(scene), median, high))


def describe(scene: Scene | Mixture) -> str:
    """Return a scene for a `repr`: its preset's name in quotes, with `shrink` where it is of crops,
    or the fields in which it differs from `Scene()`; of a mixture, its name or the list of
    these."""
    scenes = scenes_of(scene)
    names = tuple(map(_preset_name_of_crops, scenes))
    shrinks = {one.sensor.shrink for one in scenes}
    shrink = f", shrink={shrinks.pop()}" if scenes[0].is_crop and len(shrinks) == 1 else ""
    if not (shrink and all(names)):
        names, shrink = tuple(map(preset_name, scenes)), ""
    described = ", ".join(map(_describe_one, scenes, names))
    if isinstance(scene, Mixture):
        mixtures = [repr(name) for name, presets in MIXTURES.items() if names == presets]
        described = mixtures[0] if mixtures else f"[{described}]"
    return described + shrink


def _describe_one(scene: Scene, name: str) -> str:
    """Return a preset's name in quotes, or the fields of a scene without a name."""
    if name:
        return repr(name)
    changed = []
    for part, fields in scene.changed_fields().items():
        changed += [f"{part}.{name}={value!r}" for name, value in fields.items()]
    if scene.tolerance != Scene().tolerance:
        changed.append(f"tolerance={scene.tolerance!r}")
    return f"Scene({', '.join(changed)})"


@functools.lru_cache(maxsize=64)
def _preset_name_of_crops(scene: Scene) -> str:
    """Return the name of the preset whose `with_shrink` is a scene of crops, or an empty string."""
    if scene.is_crop:
        for name in Scene.presets():
            preset = Scene.preset(name)
            with contextlib.suppress(ValueError):  # of a preset that cannot be shrunk so
                if preset.with_shrink(scene.sensor.shrink) == scene:
                    return name
    return ""
