"""The controls of a scene: one for each field of its parts, made from their dataclasses."""

import dataclasses
import inspect
import math
import re
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from moireaug.scene import develop, sensor, view
from moireaug.scene.fields import bounds
from moireaug.scene.layout import LAYOUTS
from moireaug.scene.parts import PARTS
from moireaug.scenes import Scene

# of sliders, where the range that a field allows is too wide for one
SLIDER_LIMITS: dict[str, tuple[float, float]] = {
    "panel.width": (20.0, 2600.0),
    "panel.scale": (0.2, 4.0),
    "panel.lit": (0.05, 1.0),
    "panel.lit_x": (0.05, 1.0),
    "panel.lit_y": (0.05, 1.0),
    "panel.pwm": (0.0, 1000.0),
    "panel.duty": (0.05, 1.0),
    "panel.black": (0.0, 0.1),
    "panel.glare": (0.0, 0.5),
    "view.yaw": (-60.0, 60.0),
    "view.pitch": (-60.0, 60.0),
    "view.roll": (-45.0, 45.0),
    "view.zoom": (0.2, 4.0),
    "view.shift_x": (-0.5, 0.5),
    "view.shift_y": (-0.5, 0.5),
    "view.fov": (5.0, 85.0),
    "lens.k1": (-0.3, 0.3),
    "lens.k2": (-0.2, 0.2),
    "lens.blur": (0.0, 4.0),
    "lens.motion_x": (-4.0, 4.0),
    "lens.motion_y": (-4.0, 4.0),
    "lens.olpf": (0.0, 2.0),
    "sensor.pitch": (0.4, 6.0),
    "sensor.shrink": (0.0, 8.0),
    "sensor.pixels": (640.0, 8000.0),
    "sensor.focal": (0.3, 3.0),
    "sensor.scale": (0.5, 12.0),
    "sensor.fill": (0.05, 1.0),
    "sensor.gain": (0.1, 10.0),
    "sensor.shutter": (0.0, 0.05),
    "sensor.readout": (0.0, 0.05),
    "sensor.read_noise": (0.0, 0.1),
    "sensor.shot_noise": (0.0, 0.2),
    "develop.red": (0.5, 2.0),
    "develop.blue": (0.5, 2.0),
    "develop.shoulder": (0.0, 5.0),
    "develop.brighten": (-0.5, 0.5),
    "develop.chroma_blur": (0.0, 8.0),
    "develop.sharpen": (-1.0, 4.0),
    "develop.sharpen_radius": (0.3, 12.0),
}
CHOICES: dict[str, tuple[Any, ...]] = {
    "panel.layout": tuple(LAYOUTS),
    "view.pose": view.POSES,
    "sensor.reading": sensor.READINGS,
    "sensor.cfa": sensor.CFAS,
    "sensor.exposure": sensor.EXPOSURES,
    "sensor.bits": (None, *range(1, 17)),
    "develop.demosaic": develop.DEMOSAIC_NAMES,
    "develop.denoise": (None, *develop.DENOISER_NAMES),
    "develop.resize": develop.RESIZES,
}
# fields that exclude each other: a scene that states the first has no control of the second
ALTERNATIVES = {"panel.width": "panel.scale", "sensor.pitch": "sensor.scale"}
BINNED_ONLY = (
    "sensor.shrink",
    "sensor.pixels",
    "sensor.focal",
    "sensor.crop_x",
    "sensor.crop_y",
)
SLIDER_STEPS = {"panel.width": 2.0, "sensor.pixels": 2.0}  # unless 100 to 1000 positions will do


class Control(NamedTuple):
    """One field of a scene.

    Args:
        part, field: its two names.
        kind: "range", two numbers; "number", one; "switch", a bool; "choice", one of `choices`.
        description: first sentence of the field's documentation.
        low, high, step: limits and step of a slider.
        choices: allowed values; None is shown as "none".
    """

    part: str
    field: str
    kind: str
    description: str
    low: float = 0.0
    high: float = 1.0
    step: float = 0.01
    choices: tuple[Any, ...] = ()

    @property
    def name(self) -> str:
        """Return "part.field"."""
        return f"{self.part}.{self.field}"

    @property
    def value_count(self) -> int:
        """Return the number of its values."""
        return 2 if self.kind == "range" else 1

    def applies_to(self, scene: Scene) -> bool:
        """Return whether a scene has this control: all but one of each two in `ALTERNATIVES`, and
        those of crops in scenes that can be of crops."""
        if self.name in BINNED_ONLY:
            return scene.is_binned
        for stated, other in ALTERNATIVES.items():
            if self.name in (stated, other):
                part, field = stated.split(".")
                is_stated = bounds(getattr(getattr(scene, part), field))[1] > 0
                return is_stated == (self.name == stated)
        return True

    def read(self, scene: Scene) -> list[Any]:
        """Return the values that this control shows of a scene; its lowest where the scene does not
        state the field."""
        value = getattr(getattr(scene, self.part), self.field)
        if self.name in ALTERNATIVES and not self.applies_to(scene):
            value = self.low
        return list(bounds(value)) if self.kind == "range" else [value]

    def value(self, values: Sequence[Any]) -> Any:
        """Return the field's value from the values of this control; the ends of a range may come in
        either order."""
        if self.kind in ("range", "number") and None in values:
            raise ValueError(f"{self.name} is empty: enter a number.")
        if self.kind == "range":
            low, high = sorted(float(end) for end in values)
            return low if low == high else (low, high)
        return float(values[0]) if self.kind == "number" else values[0]


def _controls() -> Iterator[Control]:
    for part, cls in PARTS.items():
        descriptions = argument_sentences(cls)
        for field in dataclasses.fields(cls):
            yield _control(part, field, descriptions.get(field.name, ""))


def _control(part: str, field: dataclasses.Field[Any], description: str) -> Control:
    name = f"{part}.{field.name}"
    if name in CHOICES:
        return Control(part, field.name, "choice", description, choices=CHOICES[name])
    if isinstance(field.default, bool):
        return Control(part, field.name, "switch", description)
    allowed = field.metadata
    low, high = SLIDER_LIMITS[name] if name in SLIDER_LIMITS else (allowed["low"], allowed["high"])
    step = 10.0 ** (math.floor(math.log10(high - low)) - 2)  # 100 to 1000 positions
    step = SLIDER_STEPS.get(name, step)
    kind = "range" if "low" in allowed else "number"
    return Control(part, field.name, kind, description, low, high, step)


def argument_sentences(cls: type) -> dict[str, str]:
    """Return the first sentence about each argument in a class's docstring."""
    args = inspect.cleandoc(cls.__doc__ or "").partition("Args:\n")[2]
    sentences = {}
    for entry in re.split(r"\n(?=    \w)", "\n" + args):
        names, colon, text = " ".join(entry.split()).partition(": ")
        if colon:
            for name in names.split(", "):
                sentences[name] = re.split(r"\.(?: |$)", text)[0] + "."
    return sentences


CONTROLS: tuple[Control, ...] = tuple(_controls())


def values_of(scene: Scene) -> list[Any]:
    """Return the values of all controls for a scene, one after another."""
    values: list[Any] = []
    for control in CONTROLS:
        values += control.read(scene)
    return values


def scene_of(values: Sequence[Any], like: Scene) -> Scene:
    """Return the scene that the values of all controls describe; the inverse of `values_of`. A
    shrink makes crops of a scene that states width and pitch, see `Scene.with_shrink`.

    Args:
        like: a scene with the same controls, such as the preset that they started from.
    """
    parts_values: dict[str, dict[str, Any]] = {part: {} for part in PARTS}
    remaining = list(values)
    for control in CONTROLS:
        own_values, remaining = remaining[: control.value_count], remaining[control.value_count :]
        if control.applies_to(like):
            parts_values[control.part][control.field] = control.value(own_values)
    if not parts_values["panel"].get("width") or not parts_values["sensor"].get("pitch"):
        return Scene.from_dict(parts_values)
    shrink = parts_values["sensor"].pop("shrink")
    whole = Scene.from_dict(parts_values)
    return whole.with_shrink(shrink) if shrink else whole
