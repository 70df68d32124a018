"""A scene as data: five parts of plain numbers and ranges. No tensor is ever made here."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from moireaug.scene.fields import Range, bounds, check_number, varies
from moireaug.scene.parts import PARTS, Develop, Lens, Panel, Sensor, View
from moireaug.scene.sensor import MIN_PITCH, SHORTER_SIDE

_PANEL_SCALE = Panel.__dataclass_fields__["scale"].metadata
MIN_PANEL_SCALE, MAX_PANEL_SCALE = _PANEL_SCALE["low"], _PANEL_SCALE["high"]
PLACES = ("sensor.crop_x", "sensor.crop_y")  # which only crops have
NOMINAL_SIZE = (224, 224)  # size of a plan when none is given


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
        self._check_scales()
        self._check_reading()
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
        return low < high and (self.is_crop or name not in PLACES)

    def octave(self, size: tuple[int, int]) -> int:
        """Return the exponent of the greatest power of 2 not above a picture's longer side, by
        which crops and scenes with `Panel.width` are planned; 0 for others, which do not differ by
        size."""
        octave = 0
        if bounds(self.panel.width)[1] or self.is_crop:
            # compared, so that torch.compile, to which a size may be a symbol, guards the result
            while max(size) >= 2 ** (octave + 1):
                octave += 1
        return octave

    def panel_scales(self, size: tuple[int, int]) -> tuple[float, float]:
        """Return the least and the greatest panel pixels per image pixel, for pictures of `size`
        (height, width), and of all sizes in the same octave."""
        low, high = bounds(self.panel.width)
        if not high and self.is_crop:
            pitch, shrink = bounds(self.sensor.pitch), self._shrink_of_image()
            return shrink[0] / pitch[1], shrink[1] / pitch[0]
        if not high:
            return bounds(self.panel.scale)
        shortest = 2 ** self.octave(size)
        return low / (2 * shortest), high / shortest

    def _shrink_of_image(self) -> tuple[float, float]:
        """Return the least and the greatest sensor pixels per image pixel of a crop."""
        shrink, zoom = bounds(self.sensor.shrink), bounds(self.view.zoom)
        return shrink[0] * zoom[0], shrink[1] * zoom[1]

    def at(self, size: tuple[int, int] = NOMINAL_SIZE) -> SizedScene:
        """Return the scene for pictures of `size` (height, width), and of all sizes in the same
        octave.

        Raises:
            ValueError: a `Panel.width` of far fewer panel pixels than the picture has.
        """
        parts = {name: getattr(self, name) for name in (*PARTS, "tolerance")}
        if not bounds(self.panel.width)[1] and not self.is_crop:
            return SizedScene(**parts)
        scales = self.panel_scales(size)
        if scales[0] < MIN_PANEL_SCALE and self.panel.width:
            least = bounds(self.panel.width)[0] * MIN_PANEL_SCALE / scales[0]
            raise ValueError(
                f"Panel.width must be at least {least:g} panel pixels for pictures of {size[0]} x "
                f"{size[1]}; got {self.panel.width!r}. Raise it, or make the pictures smaller."
            )
        parts |= {"panel": replace(self.panel, width=0.0, scale=scales), "sensor": self.sensor}
        reading, pitch = "binned" if self.is_binned else "full", self.sensor.pitch
        if self.is_crop:
            parts["view"] = replace(self.view, fit=False)
            pitch = pitch or self._pitches_of_thing(scales, size)
            across, down = (
                self._extent_of_crops(place, size)
                for place in (self.sensor.crop_x, self.sensor.crop_y)
            )
            parts["sensor"] = replace(self.sensor, crop_x=across, crop_y=down)
        parts["sensor"] = replace(parts["sensor"], reading=reading, pitch=pitch)
        return SizedScene(**parts)

    def _extent_of_crops(self, place: Range, size: tuple[int, int]) -> Range:
        """Return the part of the photo, from 0 at one edge to 1 at the other, that crops see."""
        most = 2.0 ** (self.octave(size) + 1) * bounds(self.sensor.shrink)[1] / self.sensor.pixels
        low, high = bounds(place)
        side = min(1.0, most / SHORTER_SIDE)  # of a crop, over that of its photo, at most
        return low * (1 - side), high + (1 - high) * side

    def _pitches_of_thing(
        self, scales: tuple[float, float], size: tuple[int, int]
    ) -> tuple[float, float]:
        """Return the least and the greatest sensor pixels per panel pixel of a crop that shows so
        many panel pixels per image pixel."""
        shrink = self._shrink_of_image()
        low, high = shrink[0] / scales[1], shrink[1] / scales[0]
        most = Sensor.__dataclass_fields__["pitch"].metadata["high"]
        if high > most:
            raise ValueError(
                f"Panel.width = {self.panel.width!r} and Sensor.shrink = {self.sensor.shrink!r} "
                f"give pictures of {size[0]} x {size[1]} up to {high:g} sensor pixels per panel "
                f"pixel, where {most:g} are allowed. Raise Panel.width."
            )
        return max(low, MIN_PITCH), max(high, MIN_PITCH)

    def _check_scales(self) -> None:
        """Refuse crops that state one or three of what determines one another: ValueError."""
        if not self.is_crop or isinstance(self, SizedScene):
            return
        width, pitch = bounds(self.panel.width)[1] > 0, bounds(self.sensor.pitch)[1] > 0
        if width == pitch:
            raise ValueError(
                "a crop states Sensor.shrink and one of Panel.width and Sensor.pitch, from which "
                f"the other follows; got Panel.width = {self.panel.width!r}, Sensor.pitch = "
                f"{self.sensor.pitch!r}. Leave Panel.width at 0 for a part of a screen, or "
                "Sensor.pitch for something of so many panel pixels."
            )
        least, most = self.panel_scales(NOMINAL_SIZE)
        if pitch and (least < MIN_PANEL_SCALE or most > MAX_PANEL_SCALE):
            raise ValueError(
                "Sensor.shrink * View.zoom / Sensor.pitch, panel pixels per pixel of a crop, must "
                f"lie in [{MIN_PANEL_SCALE:g}, {MAX_PANEL_SCALE:g}]; got {least:g} to {most:g}."
            )

    def _check_reading(self) -> None:
        """Refuse a full reading of scenes that have no one number of sensor pixels, and fields for
        which a binned reading has no closed form: ValueError."""
        sensor, develop = self.sensor, self.develop
        if not self.is_binned:
            unfixed = f"Sensor.pitch = {sensor.pitch!r}" if sensor.pitch else ""
            if sensor.shrink:
                unfixed = f"Sensor.shrink = {sensor.shrink!r}"
            if isinstance(self.panel.width, tuple):
                unfixed = f"Panel.width = {self.panel.width!r}"
            if unfixed:
                raise ValueError(
                    f"a full reading has one number of sensor pixels for a whole batch, which "
                    f"{unfixed} does not fix. Use Sensor(reading='binned'), or Panel.scale and "
                    "Sensor.scale."
                )
            return
        only: tuple[tuple[str, object, tuple], ...] = (
            ("Sensor.exposure", sensor.exposure, ("auto", "spectral", "mean")),
            ("Develop.demosaic", develop.demosaic, ("bilinear",)),
            ("Develop.resize", develop.resize, ("area", "antialias", "point")),
            ("Develop.denoise", develop.denoise, (None,)),
            ("View.pose", self.view.pose, ("camera",)),
        )
        for name, got, allowed in only:
            if got not in allowed:
                raise ValueError(
                    f"a binned reading has no single sensor pixels: {name} must be "
                    f"{' or '.join(map(repr, allowed))}; got {got!r}. Change it, or use "
                    "Sensor(reading='full') with Panel.scale and Sensor.scale."
                )

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


@dataclass(frozen=True, kw_only=True)
class SizedScene(SceneRecord):
    """The scene that effects judge, for pictures of one octave of sizes: `Panel.width`, if given,
    is replaced by a range of `Panel.scale`, and `Sensor.reading` by "binned" or "full". Of crops,
    `Sensor.pitch` is given, too, `Panel.scale` follows, and `Sensor.crop_x` and `crop_y` are the
    part of the photo that they see."""


def _with_lists(value: Any) -> Any:
    """Return a value with lists for tuples, all the way down: YAML knows no tuples."""
    if isinstance(value, dict):
        return {key: _with_lists(inner) for key, inner in value.items()}
    if isinstance(value, (tuple, list)):
        return [_with_lists(inner) for inner in value]
    return value
