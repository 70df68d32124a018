"""Scene and Shot as users hold them, and the draw from one to the other."""

from __future__ import annotations

import json
import operator
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Integral
from typing import Any

import torch

from moireaug.capture import capture
from moireaug.checks import check_shape
from moireaug.pipeline import Plan, make_plan
from moireaug.scene.by_name import part_from_dict, parts_with, values_of
from moireaug.scene.fields import bounds, check_number, one_of
from moireaug.scene.parts import PARTS
from moireaug.scene.presets import PRESETS
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord

ANGLES = ("view.yaw", "view.pitch", "view.roll")
UNPLANNED = (
    "torch.compile cannot follow how a scene is planned: call shot.scene.plan() before, as "
    "Scene.sample does; copies and unpickled shots have no plan yet."
)
KEPT = ("_plans", "_text")  # plans by octave, and the scene as JSON, for a graph
NOMINAL_SIZE = (224, 224)  # that a plan is for where none is given


@dataclass(frozen=True, kw_only=True)
class Scene(SceneRecord):
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
    def preset(name: str) -> Scene:
        """Return the scene of that name in `moireaug.scene.presets.PRESETS`.

        Raises:
            ValueError: an unknown name; the message lists the known ones and the closest.
        """
        return _PRESETS[one_of("a preset", name, PRESETS)]

    def plan(self, size: tuple[int, int] = NOMINAL_SIZE) -> Plan:
        """Return the ordered effects that this scene calls for in photos of `size` (height, width),
        each with its reason. Only scenes with `Panel.width` differ by size: there a plan is for all
        sizes between two powers of 2. Computed once.

        Raises:
            ValueError: the "point" exposure with a layout of slanted subpixels.
        """
        octave = self.octave(size)
        plans = getattr(self, "_plans", {})  # kept here so that torch.compile finds them ready
        if octave not in plans:
            if torch.compiler.is_compiling():
                raise RuntimeError(UNPLANNED)
            plans = {**plans, octave: make_plan(self.at(size))}
            object.__setattr__(self, "_plans", plans)
            object.__setattr__(self, "_text", json.dumps(self.to_dict()))
        return plans[octave]

    def __getstate__(self) -> dict[str, Any]:
        """Leave out of copies and pickles what `plan` keeps: another version may plan otherwise."""
        return {name: value for name, value in vars(self).items() if name not in KEPT}

    def sample(
        self, n: int, size: tuple[int, int], generator: torch.Generator | None = None
    ) -> Shot:
        """Draw the ranges for `n` images of `size` (height, width), from `generator` or torch's
        global one.

        Raises:
            ValueError: an n that is no integer >= 0, a size that is not two positive integers, a
                generator that is not on the CPU, or as in `plan`.
            TypeError: a generator that is not a torch.Generator.
        """
        shot = draw(self, n, size, generator)
        # refuse a scene that cannot be photographed here, not in the middle of a batch
        self.plan(shot.size)
        return shot

    def capture(
        self, images: torch.Tensor, generator: torch.Generator | None = None
    ) -> torch.Tensor:
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
        base = Scene.preset(values.pop("preset")) if "preset" in values else Scene()
        for key in values:
            one_of("a key of a scene", key, (*PARTS, "tolerance", "preset"))
        merged, parts = base.to_dict(), {}
        for name in PARTS:
            given = {} if values.get(name) is None else values[name]
            if not isinstance(given, Mapping):
                raise TypeError(f"Scene.{name} must be a mapping of its fields; got {given!r}.")
            parts[name] = part_from_dict(name, merged[name] | dict(given))
        return Scene(**parts, tolerance=values.get("tolerance", base.tolerance))


def _scene(record: SceneRecord) -> Scene:
    return Scene(**{name: getattr(record, name) for name in (*PARTS, "tolerance")})


_PRESETS = {name: _scene(record) for name, record in PRESETS.items()}


@dataclass(frozen=True, eq=False, kw_only=True)
class Shot(ShotRecord):
    """A Scene whose ranges have been drawn: the same five parts, each ranged field a `(B,)` float64
    tensor.

    Args:
        scene: the scene that it was drawn from.
        size: height and width of the images.
        panel, view, lens, sensor, develop: the drawn parts.
        seed: (B,) int64, the seeds of the sensor noise.

    Index it like a batch (`shot[2:4]`, `shot[mask]`); change a field with `dataclasses.replace`,
    within the scene's range; other dtypes become float64. The scene's ranges decide which effects
    are computed, with which harmonics and how large filters: a value outside of them may be
    photographed inaccurately, and fields of effects left out are not read. Widen the range for
    other values.
    """

    @staticmethod
    def from_dict(values: dict[str, Any]) -> Shot:
        """Rebuild a shot from `to_dict`. Its scene may also be a Scene or a preset's name.

        Raises:
            ValueError, TypeError: a missing or unknown key, fields of different lengths, a number
                that no scene may have, or a seed or a size that is not in whole numbers.
        """
        if not isinstance(values, Mapping):
            raise TypeError(f"a shot's values must be a mapping; got {values!r}.")
        keys = ("scene", "size", "seed", *PARTS)
        for key in values:
            one_of("a key of a shot", key, keys)
        missing = [key for key in keys if key not in values]
        if missing:
            raise ValueError(
                f"a shot's dict must have the keys {', '.join(keys)}; missing {missing}."
            )
        scene, seed = as_scene(values["scene"]), values["seed"]
        _check_seed(seed)
        numbers = {}
        for part in PARTS:
            for name, given in _numbers_of(part, values[part], scene, len(seed)).items():
                numbers[f"{part}.{name}"] = torch.tensor(given, dtype=torch.float64, device="cpu")
        h, w = check_size(values["size"])
        seeds = torch.tensor(seed, dtype=torch.int64, device="cpu")
        return Shot(scene=scene, size=(h, w), seed=seeds, **parts_with(scene, numbers))


def _check_seed(seed: Any) -> None:
    if not isinstance(seed, list | tuple) or not all(
        isinstance(s, Integral) and not isinstance(s, bool) for s in seed
    ):
        raise ValueError(f"a shot's seed must be a list of whole numbers; got {seed!r}.")
    if not all(-(2**63) <= s < 2**63 for s in seed):
        raise ValueError(f"a shot's seed must lie in [-2**63, 2**63), 64 bits; got {seed!r}.")


def _numbers_of(part: str, given: Any, scene: Scene, n: int) -> dict[str, list[float]]:
    """Return the drawn fields of one part of a shot's dict, checked."""
    if not isinstance(given, Mapping):
        raise TypeError(f"a shot's {part} must be a mapping of its fields; got {given!r}.")
    wanted = getattr(scene, part).ranged
    for name in given:
        one_of(f"a field of a shot's {part}", name, wanted)
    checked = {}
    for name in wanted:
        numbers, allowed = given.get(name), PARTS[part].__dataclass_fields__[name].metadata
        if not isinstance(numbers, list | tuple) or len(numbers) != n:
            raise ValueError(
                f"a shot's {part}.{name} must hold {n} numbers, one per image of its seed list."
            )
        checked[name] = [check_number(f"a shot's {part}.{name}", x, **allowed) for x in numbers]
    return checked


def check_size(size: Any) -> tuple[int, int]:
    """Return a size (height, width) in integers.

    Raises:
        ValueError: anything but two whole numbers of at least 1.
    """
    try:
        h, w = (operator.index(side) for side in size)
    except (TypeError, ValueError):  # no pair, or no integers
        h, w = 0, 0
    if h < 1 or w < 1:
        raise ValueError(
            "a shot needs a size (height, width) of at least 1 x 1 pixels, in whole numbers; got "
            f"{size!r}."
        )
    return h, w


def draw(
    scene: Scene, n: int, size: tuple[int, int], generator: torch.Generator | None = None
) -> Shot:
    """Draw `n` shots for images of `size` (height, width).

    Each image's numbers are drawn together, so the first rows of a larger draw are those of a
    smaller one. Only ranges take random numbers: the value of a fixed field does not
    change the others' draws.

    Raises:
        ValueError, TypeError: as `random_numbers`, and a size that is not two positive integers.
    """
    h, w = check_size(size)
    return shot_of(scene, (h, w), random_numbers(n, numbers_needed(scene), generator))


def random_numbers(n: int, count: int, generator: torch.Generator | None) -> torch.Tensor:
    """Return numbers in [0, 1) to draw from, `count` for each of `n` images: (n, count) float64, on
    the CPU.

    Raises:
        ValueError: an n that is no integer >= 0, or a generator that is not on the CPU.
        TypeError: a generator that is not a torch.Generator.
    """
    if isinstance(n, bool) or not isinstance(n, Integral) or n < 0:
        raise ValueError(f"a shot needs a whole number n >= 0 of images; got n = {n!r}.")
    if not (generator is None or isinstance(generator, torch.Generator)):
        raise TypeError(
            f"generator must be a torch.Generator or None; got {generator!r}. For a seed, pass "
            "torch.Generator().manual_seed(seed)."
        )
    if generator is not None and generator.device.type != "cpu":
        raise ValueError(
            f"shots are drawn on the CPU, whatever device the images are on; got a generator on "
            f"{generator.device}. Pass torch.Generator().manual_seed(seed)."
        )
    return torch.rand(int(n), count, dtype=torch.float64, device="cpu", generator=generator)


def numbers_needed(scene: Scene) -> int:
    """Return how many random numbers a shot takes: one for each range, and one for the seed."""
    ranges = map(bounds, values_of(scene).values())
    return sum(low < high for low, high in ranges) + 1


def shot_of(scene: Scene, size: tuple[int, int], u: torch.Tensor) -> Shot:
    """Return the shots of images of `size` (height, width) that lie in the scene's ranges where `u`
    (n, numbers_needed(scene)) says, from 0, the low end, to 1."""
    ranges = {name: bounds(value) for name, value in values_of(scene).items()}
    varied = [i for i, (low, high) in enumerate(ranges.values()) if low < high]
    given = torch.tensor(list(ranges.values()), dtype=torch.float64, device="cpu")
    low, high = given.mT[..., None]
    values = low.repeat(1, len(u))
    values[varied] = low[varied] + (high - low)[varied] * u[:, :-1].mT
    numbers = {}
    for name, row in zip(ranges, values, strict=True):
        numbers[name] = row.clone()  # a row of the table would be pickled with all of it
    if scene.view.pose == "released":
        for angle in ANGLES:
            numbers[angle] = numbers[angle].floor()  # the released code turns by whole degrees
    seed = (u[:, -1] * 2**53).to(torch.int64)
    return Shot(scene=scene, size=size, seed=seed, **parts_with(scene, numbers))


def as_scene(scene: Scene | str | Mapping[str, Any]) -> Scene:
    """Return a Scene from a Scene, a preset's name or a mapping, such as a dict. Where several may
    be given, see `mixture.as_scenes`.

    Raises:
        ValueError: an unknown name, or a file's.
        TypeError: anything else.
    """
    if isinstance(scene, Scene):
        return scene
    if isinstance(scene, str):
        if scene.endswith((".yaml", ".yml")):
            raise ValueError(
                f"a scene's file is for the commands; got {scene!r}. Pass what it holds, "
                f"yaml.safe_load(open({scene!r}))."
            )
        return Scene.preset(scene)
    if isinstance(scene, Mapping):
        return Scene.from_dict(scene)
    raise TypeError(
        f"scene must be a Scene, a preset's name or a dict; got {type(scene).__name__}."
    )
