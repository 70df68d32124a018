"""What stands in front of the camera, and how it may vary.

A `Scene` is five records of plain numbers: `Panel`, `View`, `Lens`, `Sensor` and `Develop`. Every numeric field
that is documented as a *range* takes a number or a `(low, high)` pair; pairs are drawn uniformly, once per image, by
`Scene.sample`. The same five records, filled with `(B,)` tensors, make up a `Shot`: a Shot is a Scene whose ranges have
been drawn. No tensor is ever made here.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from moireaug.fields import check_number, one_of
from moireaug.parts import PARTS, Develop, Lens, Panel, Sensor, View, part_from_dict

if TYPE_CHECKING:
    import torch

    from moireaug.plan import Plan
    from moireaug.shot import Shot


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A camera in front of a screen: `Panel + View + Lens + Sensor + Develop`. Immutable, hashable, no tensors.

    Args:
        panel, view, lens, sensor, develop: the five parts; each has its own defaults, which do nothing but show an RGB
            stripe to a Bayer sensor.
        tolerance: contrast, in raw units, below which the plan leaves a contribution out. Each effect and each harmonic
            that is left out stays below it; of a sharp lens many harmonics are left out, whose sum may reach a few
            times as much.

    Raises:
        ValueError, TypeError: a value out of its range, with what was got and what is allowed.
    """

    panel: Panel = Panel()
    view: View = View()
    lens: Lens = Lens()
    sensor: Sensor = Sensor()
    develop: Develop = Develop()
    tolerance: float = 1 / 512

    def __post_init__(self) -> None:
        for name, kind in PARTS.items():
            if not isinstance(getattr(self, name), kind):
                raise TypeError(f"Scene.{name} must be a {kind.__name__}; got {getattr(self, name)!r}.")
        object.__setattr__(self, "tolerance", check_number("Scene.tolerance", self.tolerance, 0.0, 1.0, ""))

    @staticmethod
    def preset(name: str) -> Scene:
        """The scene of that name in `moireaug.presets.PRESETS`.

        Raises:
            ValueError: an unknown name; the message lists the known ones and the closest.
        """
        from moireaug.presets import PRESETS

        return PRESETS[one_of("a preset", name, PRESETS)]

    def plan(self) -> Plan:
        """The ordered effects that this scene calls for, each with its reason. Computed once per scene."""
        found = getattr(self, "_plan", None)  # kept here so that torch.compile finds it ready
        if found is None:
            from moireaug.plan import plan_of

            found = plan_of(self)
            object.__setattr__(self, "_plan", found)
        return found

    def sample(self, n: int, size: tuple[int, int], generator: torch.Generator | None = None) -> Shot:
        """Draw the ranges for `n` images of `size` (height, width), from `generator` or torch's global one."""
        from moireaug.shot import draw

        return draw(self, n, size, generator)

    def capture(self, images: torch.Tensor, generator: torch.Generator | None = None) -> torch.Tensor:
        """Draw a shot for `images` (B, 3, H, W) and return their photos, of the same shape."""
        from moireaug.capture import capture

        return capture(images, self.sample(images.shape[0], tuple(images.shape[-2:]), generator))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, strings and pairs, fit for JSON and YAML; `from_dict` is the inverse."""
        return {k: v if k == "tolerance" else {a: list(b) if isinstance(b, tuple) else b for a, b in v.items()}
                for k, v in asdict(self).items()}  # fmt: skip

    @staticmethod
    def from_dict(values: dict[str, Any]) -> Scene:
        """Rebuild a scene; a part that is absent keeps its defaults, `preset` may name the scene to start from.

        Raises:
            ValueError, TypeError: an unknown key (the message names the closest) or a value out of its range.
        """
        values = dict(values)
        base = Scene.preset(values.pop("preset")) if "preset" in values else Scene()
        for key in values:
            one_of("a key of a scene", key, (*PARTS, "tolerance", "preset"))
        merged = base.to_dict()
        parts = {k: part_from_dict(k, merged[k] | dict(values.get(k) or {})) for k in PARTS}
        return Scene(**parts, tolerance=values.get("tolerance", base.tolerance))


def as_scene(scene: Scene | str | dict[str, Any]) -> Scene:
    """A Scene from a Scene, a preset's name or a plain dict; what every public `scene=` argument accepts."""
    if isinstance(scene, Scene):
        return scene
    if isinstance(scene, str):
        return Scene.preset(scene)
    if isinstance(scene, dict):
        return Scene.from_dict(scene)
    raise TypeError(f"scene must be a Scene, a preset's name or a dict; got {type(scene).__name__}.")
