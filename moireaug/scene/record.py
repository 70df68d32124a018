"""A scene as data: five parts of plain numbers and ranges. No tensor is ever made here."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from typing import Any

from moireaug.scene.fields import bounds, check_number, varies
from moireaug.scene.parts import PARTS, Develop, Lens, Panel, Sensor, View
from moireaug.scene.scene_checks import check_reading, check_scales

CROPS_ONLY = ("sensor.crop_x", "sensor.crop_y")  # fields that are not read of whole photos
WHOLE_ONLY = ("view.fov",)  # nor this of crops


@dataclass(frozen=True, kw_only=True)
class SceneRecord:
    """The five parts of a `Scene` and its tolerance, checked; users hold a `Scene`.

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
                raise TypeError(
                    f"Scene.{name} must be a {kind.__name__}; got {getattr(self, name)!r}."
                )
            for field in kind.ranged:
                value = getattr(getattr(self, name), field)
                if not isinstance(value, (float, tuple)):  # a drawn one, as in a shot
                    raise TypeError(
                        f"{kind.__name__}.{field} of a scene must be a number or a (low, high) "
                        f"pair of numbers; got {value!r}."
                    )
        check_scales(self.panel, self.view, self.sensor)
        check_reading(self.panel, self.view, self.sensor, self.develop, is_binned=self.is_binned)
        object.__setattr__(
            self, "tolerance", check_number("Scene.tolerance", self.tolerance, 0.0, 1.0, "")
        )

    @property
    def is_binned(self) -> bool:
        """Whether the reading is binned: one cell of colours for each photo pixel."""
        if self.sensor.reading != "auto":
            return self.sensor.reading == "binned"
        return self.is_crop or bounds(self.sensor.pitch)[1] > 0 or bounds(self.panel.width)[1] > 0

    @property
    def is_crop(self) -> bool:
        """Whether images are parts of larger photos."""
        return bounds(self.sensor.shrink)[1] > 0

    @property
    def is_rectified(self) -> bool:
        """Whether the bins of a binned reading lie in the image's frame, one for each of its
        pixels: as if the photo had been registered at the sensor's resolution, and then shrunk."""
        return self.is_binned and self.develop.registered

    @property
    def is_dark_around(self) -> bool:
        """Whether photos show the dark around the picture: those in the camera's frame, unless the
        screen goes on past it."""
        return not self.develop.registered and not (
            self.is_crop and bounds(self.sensor.pitch)[1] > 0
        )

    @property
    def is_binned_bayer(self) -> bool:
        """Whether each value of the reading averages the sensor pixels of one colour."""
        return self.is_binned and self.sensor.cfa == "rggb"

    @property
    def filter_cell(self) -> str:
        """The key in `geometry.lattice.CFA` of the cell of colour filters that the reading has."""
        return "binned" if self.is_binned_bayer else self.sensor.cfa

    @property
    def shows_pattern(self) -> bool:
        """Whether the exposure may show the panel's pattern, and not its mean light alone."""
        return self.sensor.exposure != "mean"

    @property
    def is_solid(self) -> bool:
        """Whether panel pixels always emit all colours over their whole area."""
        return self.panel.cell.is_solid and not self.panel.has_black_matrix

    @property
    def is_posed(self) -> bool:
        """Whether the screen is ever anything but frontal and edge to edge."""
        view = self.view
        turned = varies(view.yaw) or varies(view.pitch) or varies(view.roll)
        moved = varies(view.shift_x) or varies(view.shift_y) or varies(view.zoom, 1.0)
        return turned or moved or view.pose == "released"

    @property
    def is_bent(self) -> bool:
        """Whether the lens ever distorts."""
        return varies(self.lens.k1) or varies(self.lens.k2)

    @property
    def moves(self) -> bool:
        """Whether points move from image to photo: a photo in the camera's frame, with a pose or
        lens distortion."""
        return not self.develop.registered and (self.is_posed or self.is_bent)

    def is_drawn(self, name: str) -> bool:
        """Whether draws differ in a field such as "view.yaw": one that is a range, and read."""
        part, field = name.split(".")
        low, high = bounds(getattr(getattr(self, part), field))
        return low < high and name not in (WHOLE_ONLY if self.is_crop else CROPS_ONLY)

    def with_parts(self, **parts: Any) -> SceneRecord:
        """Return the same scene with other parts, which are not checked against one another."""
        scene = object.__new__(SceneRecord)
        values = {name: getattr(self, name) for name in (*PARTS, "tolerance")}
        for name, value in (values | parts).items():
            object.__setattr__(scene, name, value)
        return scene

    def changed_fields(self) -> dict[str, dict[str, Any]]:
        """Return the fields in which the parts differ from those of `Scene()`, by part."""
        changed: dict[str, dict[str, Any]] = {}
        for name, kind in PARTS.items():
            given, default = getattr(self, name), kind()
            changed[name] = {}
            for field in fields(given):
                value = getattr(given, field.name)
                if value != getattr(default, field.name):
                    changed[name][field.name] = value
        return changed

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, strings and pairs, fit for JSON and YAML; `Scene.from_dict` is the
        inverse."""
        return _with_lists(asdict(self))

    def as_json(self) -> str:
        """Return `to_dict` as JSON. Made once: torch.compile finds it ready, and guards it."""
        text = getattr(self, "_json", None)
        if text is None:
            text = json.dumps(self.to_dict())
            object.__setattr__(self, "_json", text)
        return text


def _with_lists(value: Any) -> Any:
    """Return a value with lists for tuples, all the way down: YAML knows no tuples."""
    if isinstance(value, dict):
        return {key: _with_lists(inner) for key, inner in value.items()}
    if isinstance(value, (tuple, list)):
        return [_with_lists(inner) for inner in value]
    return value
