"""A scene as data: five parts of plain numbers and ranges. No tensor is ever made here."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from moireaug.scene.fields import check_number
from moireaug.scene.parts import PARTS, Develop, Lens, Panel, Sensor, View


@dataclass(frozen=True, kw_only=True)
class SceneRecord:
    """The five parts of a `Scene` and its tolerance, checked. Effects judge by this record; users
    hold a `Scene`.

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
        object.__setattr__(
            self, "tolerance", check_number("Scene.tolerance", self.tolerance, 0.0, 1.0, "")
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, strings and pairs, fit for JSON and YAML; `Scene.from_dict` is the
        inverse."""
        return _plain(asdict(self))


def _plain(value: Any) -> Any:
    """Return a value with lists for tuples, all the way down: YAML knows no tuples."""
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(inner) for inner in value]
    return value
