"""What `Shot.from_dict` takes: plain numbers and lists, checked."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from numbers import Integral
from typing import Any

import torch
from torch import Tensor

from moireaug.common.argument_checks import one_of
from moireaug.scene.by_name import limits_by_name
from moireaug.scene.draws import check_size
from moireaug.scene.fields import check_number
from moireaug.scene.parts import PARTS
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import WholeImage


def check_shot_keys(values: Any) -> None:
    """Refuse, with a ValueError or TypeError, what is no dict of a shot with all of its keys."""
    if not isinstance(values, Mapping):
        raise TypeError(f"a shot's values must be a mapping; got {values!r}.")
    keys = ("scene", "size", "seed", *PARTS)
    for key in values:
        one_of("a key of a shot", key, (*keys, "part_of"))
    missing = [key for key in keys if key not in values]
    if missing:
        raise ValueError(f"a shot's dict must have the keys {', '.join(keys)}; missing {missing}.")


def numbers_from_dict(
    scene: SceneRecord, values: Mapping[str, Any]
) -> tuple[dict[str, Tensor], Tensor]:
    """Return the fields and seeds of a shot, as `draws.draw_numbers` does, from its dict, checked:
    ValueError, TypeError."""
    seed = values["seed"]
    if not isinstance(seed, list | tuple) or not all(
        isinstance(s, Integral) and not isinstance(s, bool) for s in seed
    ):
        raise ValueError(f"a shot's seed must be a list of whole numbers; got {seed!r}.")
    if not all(-(2**63) <= s < 2**63 for s in seed):
        raise ValueError(f"a shot's seed must lie in [-2**63, 2**63), 64 bits; got {seed!r}.")
    numbers, allowed = {}, limits_by_name(scene)
    for part in PARTS:
        given, fields = values[part], getattr(scene, part)
        if not isinstance(given, Mapping):
            raise TypeError(f"a shot's {part} must be a mapping of its fields; got {given!r}.")
        for name in given:
            one_of(f"a field of a shot's {part}", name, fields.ranged)
        for name in fields.ranged:
            row, unit = given.get(name), fields.__dataclass_fields__[name].metadata["unit"]
            ends = allowed[f"{part}.{name}"]
            if not isinstance(row, list | tuple) or len(row) != len(seed):
                raise ValueError(
                    f"a shot's {part}.{name} must hold {len(seed)} numbers, one per image of its "
                    f"seed list; got {row!r}."
                )
            checked = [check_number(f"a shot's {part}.{name}", x, *ends, unit) for x in row]
            numbers[f"{part}.{name}"] = torch.tensor(checked, dtype=torch.float64, device="cpu")
    return numbers, torch.tensor(seed, dtype=torch.int64, device="cpu")


def whole_from_dict(whole: Any) -> WholeImage:
    """Return the image of which a shot's is a part, from the plain values in its dict; refuse
    anything but two pairs of whole numbers with a ValueError."""
    try:
        top, left = map(operator.index, whole["corner"])
        return WholeImage(check_size(whole["size"]), (top, left))
    except (KeyError, TypeError, ValueError):
        raise ValueError(
            "a shot's part_of must hold the size (height, width) of the larger image, and the "
            f"corner (row, column) at which the part begins; got {whole!r}."
        ) from None
