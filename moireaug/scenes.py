"""Scene and Shot as users hold them, and the draw from one to the other."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, get_args

import torch
from torch import Tensor

from moireaug.camera.scene_plans import PlannedScene
from moireaug.capture import capture, develop, reading_of
from moireaug.common.argument_checks import check_whole, one_of
from moireaug.common.image_checks import check_shape
from moireaug.engine import operators
from moireaug.scene.by_name import parts_from_dict, parts_with
from moireaug.scene.draws import (
    MAX_CACHED_SCENES,
    check_size,
    draw_numbers,
    numbers_needed,
    random_numbers,
)
from moireaug.scene.expected_moire import moire_of
from moireaug.scene.plan import Moire, Plan
from moireaug.scene.preset_names import PresetName
from moireaug.scene.presets import MIXTURES, PRESETS
from moireaug.scene.sensor import MIN_SHRINK
from moireaug.scene.shot import ShotRecord
from moireaug.scene.shot_dict import check_shot_keys, numbers_from_dict, whole_from_dict
from moireaug.scene.sized import NOMINAL_SIZE, parts_of_crops
from moireaug.scene.track import DEFAULT_HAND, Hand, track_of

MOIRE_SHOTS = 128  # of which the expected moiré is found


@dataclass(frozen=True, kw_only=True)
class Scene(PlannedScene):
    """A camera in front of a screen: `Panel + View + Lens + Sensor + Develop`. Immutable, hashable,
    no tensors.

    Every numeric field that is documented as a *range* takes a number or a `(low, high)` pair;
    pairs are drawn uniformly, once per image, by `sample`. The same five records, filled with
    `(B,)` tensors, make up a `Shot`: a Shot is a Scene whose ranges have been drawn.

    Args:
        panel, view, lens, sensor, develop: the five parts; the defaults only show an RGB stripe to
            a Bayer sensor.
        tolerance: contrast, in raw units, below which the plan leaves a contribution out. Each
            effect and each harmonic that is left out stays below it; with a sharp lens, many
            harmonics are left out, whose sum may reach a few times the tolerance.

    Raises:
        ValueError, TypeError: a value out of its range, with what was got and what is allowed.
    """

    @staticmethod
    def preset(name: PresetName) -> Scene:
        """Return the scene of that name, one of `presets`.

        Raises:
            ValueError: an unknown name, where the message lists the known ones and the closest; or
                a mixture's, such as "anywhere", which is several scenes: see `mixtures.as_scenes`.
        """
        return _preset_of(name)

    @staticmethod
    def presets() -> tuple[PresetName, ...]:
        """Return the names of all presets."""
        return get_args(PresetName)

    def plan(self, size: tuple[int, int] = NOMINAL_SIZE) -> Plan:
        """Return the ordered effects that this scene calls for in photos of `size` (height, width),
        each with its reason, how many panel and sensor pixels an image pixel gets, and
        `expected_moire`. Only crops and scenes with `Panel.width` differ by size: there the effects
        are those of all sizes between two powers of 2.

        Raises:
            ValueError: the "point" or "box" exposure with a layout of slanted subpixels, a size
                that is not two positive integers, or one too large for `Panel.width`.
            RuntimeError: within torch.compile, if no plan of such a size was made before.
        """
        size = check_size(size)
        return replace(self.plan_effects(size), moire=self.expected_moire(size))

    def expected_moire(self, size: tuple[int, int] = NOMINAL_SIZE) -> Moire | None:
        """Return about how much moiré photos of `size` (height, width) will show, from the panel's
        harmonics in the middle of the image of 128 shots, the same ones whenever it is asked; None
        for full readings, which have no closed form. Errors as of `plan`."""
        return _expected_moire(self, check_size(size))

    def sample(
        self, n: int, size: tuple[int, int], generator: torch.Generator | None = None
    ) -> Shot:
        """Draw the ranges for `n` images of `size` (height, width), from `generator` or torch's
        global one.

        Each image's numbers are drawn together, so the first rows of a larger draw are those of a
        smaller one.

        Raises:
            ValueError: an n that is no integer >= 0, a size that is not two positive integers, a
                generator that is not on the CPU, or as in `plan`.
            TypeError: a generator that is not a torch.Generator.
        """
        size = check_size(size)
        return self.draw(self.random_numbers(n, generator), size)

    def sample_track(
        self,
        n: int,
        frames: int,
        size: tuple[int, int],
        generator: torch.Generator | None = None,
        hand: Hand = DEFAULT_HAND,
    ) -> Shot:
        """Draw `n` shots as `sample` does, and film each by hand for so many frames: the same
        screen, camera and exposure, the pose as `hand` moves it, sensor noise of its own in each
        frame.

        Returns:
            a shot of n * frames images. Row i * frames + k is frame k of track i, as in
            `capture(videos.flatten(0, 1), shot)` of videos (n, frames, 3, H, W). Frame 0 has the
            numbers that `sample` draws.

        Raises:
            TypeError, ValueError: as `sample`; frames that are no whole number of at least 1; a
                scene with View.pose = "released"; a hand that may move the pose too far.
        """
        check_whole("frames", frames, 1)
        return track_of(self.sample(n, size, generator), [frames] * n, hand)

    def random_numbers(self, n: int, generator: torch.Generator | None = None) -> Tensor:
        """Return the random numbers of `n` images, of whatever size, from which `draw` does;
        arguments and errors as of `sample`."""
        return random_numbers(n, numbers_needed(self), generator)

    def draw(self, u: Tensor, size: tuple[int, int]) -> Shot:
        """Return the shot that `random_numbers` give of images of `size` (height, width); others
        are refused: ValueError."""
        return self.shot_from_numbers(size, *draw_numbers(self, u))

    def shot_from_numbers(
        self, size: tuple[int, int], numbers: Mapping[str, Tensor], seed: Tensor
    ) -> Shot:
        """Return the shot of drawn numbers, (B,) each, by names such as "view.yaw", for images of
        `size` (height, width)."""
        return Shot(scene=self, size=size, seed=seed, **parts_with(self, numbers))

    def with_shrink(self, shrink: float | Sequence[float]) -> Scene:
        """Return the same scene for images that are crops: parts of photos that have `shrink`
        sensor pixels per pixel, a number or a (low, high) pair; see `Sensor.shrink`. A scene that
        states `Panel.width` and `Sensor.pitch` keeps the pitch: a part of the screen is seen.

        Raises:
            ValueError, TypeError: a scene of a full reading, or a shrink out of its range.
        """
        panel, sensor = parts_of_crops(self, shrink)
        scene = replace(self, panel=panel, sensor=sensor)
        if not scene.is_crop:
            raise ValueError(
                f"shrink must be at least {MIN_SHRINK:g}; got 0. For whole photos, leave it out."
            )
        return scene

    def capture(self, images: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Draw a shot for `images` (B, 3, H, W), from `generator` or torch's global one, and return
        their photos.

        Dtype, gradients and errors as in `capture`.
        """
        check_shape(images)
        n, _, h, w = images.shape
        return capture(images, self.sample(n, (h, w), generator))

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> Scene:
        """Rebuild a scene. Missing parts and fields are those of the scene that `preset` names, or
        else the defaults.

        Raises:
            ValueError, TypeError: an unknown key (the message names the closest) or a value out of
                its range.
        """
        if not isinstance(values, Mapping):
            raise TypeError(
                f"a scene's values must be a mapping; got {values!r}. A preset's name is taken by "
                "Scene.preset."
            )
        values = dict(values)
        base = _preset_of(values.pop("preset")) if "preset" in values else Scene()
        tolerance = values.pop("tolerance", base.tolerance)
        return Scene(**parts_from_dict(values, base.to_dict()), tolerance=tolerance)


@functools.lru_cache(maxsize=MAX_CACHED_SCENES)
def _expected_moire(scene: Scene, size: tuple[int, int]) -> Moire | None:
    return moire_of(scene.sample(MOIRE_SHOTS, size, torch.Generator().manual_seed(0)))


_PRESETS = {name: Scene(**vars(record)) for name, record in PRESETS.items()}


def _preset_of(name: str) -> Scene:
    """Return `Scene.preset` of any text."""
    if one_of("a preset", name, (*PRESETS, *MIXTURES)) in MIXTURES:
        raise ValueError(
            f"{name!r} is a mixture of {len(MIXTURES[name])} presets, where one scene is needed. "
            f"Name one of them ({', '.join(MIXTURES[name])}), or pass scene={name!r} alone, in no "
            "list, to a transform, an attack, Pairs or evaluate."
        )
    return _PRESETS[name]


@dataclass(frozen=True, eq=False, kw_only=True)
class Shot(ShotRecord):
    """A Scene whose ranges have been drawn: the same five parts, each ranged field a `(B,)` float64
    tensor.

    Args:
        scene: the scene that it was drawn from.
        size: height and width of the images.
        panel, view, lens, sensor, develop: the drawn parts.
        seed: (B,) int64, the seeds of the sensor noise.
        part_of: the larger image of whose photo this is the shot of a part, if any; see `crop`.

    Index it like a batch (`shot[2:4]`, `shot[mask]`); change a field with `dataclasses.replace`,
    within the scene's range; other dtypes become float64. The scene's ranges decide which effects
    are computed, with which harmonics and how large filters: a value outside of them may be
    photographed inaccurately, and fields of effects left out are not read. Widen the range for
    other values.
    """

    scene: Scene

    def __post_init__(self) -> None:
        """Plan: a scene that cannot be photographed is refused here, not in the middle of a
        batch."""
        if not isinstance(self.scene, Scene):
            raise TypeError(f"a shot's scene must be a Scene; got {self.scene!r}.")
        super().__post_init__()
        object.__setattr__(self, "plan", self.scene.plan_effects(self.whole_size))

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the plan, which another version may make otherwise, and the table of numbers,
        which `__post_init__` makes again."""
        return {n: value for n, value in vars(self).items() if n not in ("plan", "_numbers")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.__post_init__()

    @staticmethod
    def from_dict(values: dict[str, Any]) -> Shot:
        """Rebuild a shot from `to_dict`. Its scene may also be a Scene or a preset's name.

        Raises:
            ValueError, TypeError: a missing or unknown key, fields of different lengths, a number
                that no scene may have, or a seed or a size that is not in whole numbers.
        """
        check_shot_keys(values)
        scene = values["scene"]
        if isinstance(scene, str):
            scene = _preset_of(scene)
        elif not isinstance(scene, Scene):
            scene = Scene.from_dict(scene)
        numbers, seed = numbers_from_dict(scene, values)
        size = check_size(values["size"])
        if values.get("part_of") is None:
            return scene.shot_from_numbers(size, numbers, seed)
        whole = whole_from_dict(values["part_of"])
        return scene.shot_from_numbers(whole.size, numbers, seed).crop(*whole.corner, *size)


operators.implement(reading_of, develop, Scene.from_dict)  # for graphs of torch.compile
