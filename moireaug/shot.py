"""Shot: one draw from a Scene for a batch of images."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from moireaug.effects.bayer import REACH, Readout, readout
from moireaug.effects.view import homography, image_to_photo, look
from moireaug.fields import bounds, ranged_fields
from moireaug.parts import PARTS, Develop, Lens, Panel, Sensor, View
from moireaug.scene import Scene


@dataclass(frozen=True, eq=False, kw_only=True)
class Shot:
    """A Scene whose ranges have been drawn: the same five parts, each ranged field a `(B,)` float64 tensor.

    Args:
        scene: where it was drawn from; it decides which effects are computed.
        size: height and width of the images.
        panel, view, lens, sensor, develop: the drawn parts.
        seed: (B,) int64, the seeds of the sensor noise.

    Index it like a batch (`shot[2:4]`, `shot[mask]`); change a field with `dataclasses.replace`. The scene's plan
    decides which effects are computed: a field whose effect the scene does not call for is not read.
    """

    scene: Scene
    size: tuple[int, int]
    panel: Panel
    view: View
    lens: Lens
    sensor: Sensor
    develop: Develop
    seed: Tensor

    def __len__(self) -> int:
        return len(self.seed)

    @property
    def device(self) -> torch.device:
        return self.seed.device

    def _map(self, f: Any) -> Shot:
        parts = {}
        for name in PARTS:
            part = getattr(self, name)
            parts[name] = dataclasses.replace(part, **{k: f(getattr(part, k)) for k in ranged_fields(part)})
        return dataclasses.replace(self, **parts, seed=f(self.seed))

    def to(self, device: torch.device | str) -> Shot:
        """The same shot on another device."""
        return self if torch.device(device) == self.device else self._map(lambda t: t.to(device))

    def __getitem__(self, rows: Any) -> Shot:
        """The shots of some rows: a slice, a mask, an index tensor or list, or one integer (a batch of one)."""
        rows = [rows] if isinstance(rows, int) else rows
        return self._map(lambda t: t[rows])

    def repeat(self, n: int) -> Shot:
        """The whole batch n times, one after another."""
        return self._map(lambda t: t.repeat(n))

    @property
    def bends(self) -> tuple[Tensor, Tensor] | None:
        """(k1, k2) where the plan has a lens that distorts, else None."""
        return (self.lens.k1, self.lens.k2) if "lens" in self.scene.plan() else None

    def matrix(self) -> Tensor:
        """Homography from image to ideal photo coordinates, (B, 3, 3) float64. Differentiable in every View field that
        the scene's pose reads."""
        view = {k: getattr(self.view, k) for k in ranged_fields(self.view)}
        return homography(
            view, self.lens.k1, self.lens.k2, self.size, self.scene.sensor.scale,
            pose=self.scene.view.pose, fit=self.scene.view.fit,
        )  # fmt: skip

    def readouts(self) -> tuple[Readout, Readout]:
        """Which sensor rows and columns this photo reads."""
        sensor, develop = self.scene.sensor, self.scene.develop
        reach = REACH[develop.demosaic] if sensor.cfa != "none" else 0
        # a denoiser looks at every pixel of the sensor
        how = "all" if develop.denoise else develop.resize
        return tuple(readout(n, sensor.scale, how, reach) for n in self.size)  # type: ignore[return-value]

    def raw_shape(self) -> tuple[int, int, int, int]:
        """Shape of the packed raw reading, and so of the attacker's noise: four Bayer planes, or three colours."""
        rows, cols = self.readouts()
        planes, stride = (3, 1) if self.scene.sensor.cfa == "none" else (4, 2)
        return len(self), planes, len(rows.index) // stride, len(cols.index) // stride

    @property
    def moves(self) -> bool:
        """Whether things lie elsewhere in the photo than in the image: a camera-frame photo with a pose or a lens."""
        plan = self.scene.plan()
        return not self.scene.develop.registered and ("pose" in plan or "lens" in plan)

    def to_photo(self, points: Tensor) -> Tensor:
        """Where points (B, N, 2) of the image, x then y in pixels, lie in the photo's own frame.

        For a registered scene that frame is the image's, and points come back as they are.
        """
        if not self.moves:
            return points
        shot = self.to(points.device)
        return image_to_photo(points.double(), shot.matrix(), self.size, shot.bends).to(points.dtype)

    def to_photo_mask(self, mask: Tensor) -> Tensor:
        """A mask (B, C, H, W) of the image, of any dtype, in the photo's own frame: nearest pixel, 0 off the image."""
        if not self.moves:
            return mask
        h, w = self.size
        shot = self.to(mask.device)
        rows, cols = (torch.arange(n, dtype=torch.float64, device=mask.device) + 0.5 for n in self.size)
        x, y = look(
            torch.linalg.inv(shot.matrix()), rows, cols, self.size, affine=self.scene.plan().affine, lens=shot.bends
        )
        on = (x >= 0) & (x < w) & (y >= 0) & (y < h)
        flat = torch.where(on, y.floor() * w + x.floor(), 0).long()[:, None].flatten(2)
        taken = mask.flatten(2).gather(2, flat.expand(-1, mask.shape[1], -1)).reshape(mask.shape)
        return torch.where(on[:, None], taken, torch.zeros_like(taken))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and lists, exact; `Shot.from_dict` is the inverse."""
        drawn = {
            name: {k: getattr(getattr(self, name), k).tolist() for k in ranged_fields(getattr(self, name))}
            for name in PARTS
        }
        return {"scene": self.scene.to_dict(), "size": list(self.size), "seed": self.seed.tolist(), **drawn}

    @staticmethod
    def from_dict(values: dict[str, Any]) -> Shot:
        """Rebuild a shot from `to_dict`.

        Raises:
            ValueError: a missing part or field, or fields of different lengths.
        """
        missing = [k for k in ("scene", "size", "seed", *PARTS) if k not in values]
        if missing:
            raise ValueError(
                f"a shot's dict must have the keys scene, size, seed, {', '.join(PARTS)}; missing {missing}."
            )
        scene, n, parts = Scene.from_dict(values["scene"]), len(values["seed"]), {}
        for name in PARTS:
            part = getattr(scene, name)
            for k in ranged_fields(part):
                if len(values[name].get(k, ())) != n:
                    raise ValueError(f"a shot's {name}.{k} must hold {n} numbers, one per image of its seed list.")
            drawn = {k: torch.tensor(values[name][k], dtype=torch.float64) for k in ranged_fields(part)}
            parts[name] = dataclasses.replace(part, **drawn)
        h, w = values["size"]
        return Shot(scene=scene, size=(h, w), seed=torch.tensor(values["seed"], dtype=torch.int64), **parts)


def draw(scene: Scene, n: int, size: tuple[int, int], generator: torch.Generator | None = None) -> Shot:
    """Draw `n` shots for images of `size` (height, width).

    Each image's numbers are drawn together, so the first rows of a larger draw are those of a smaller one. Only what
    varies draws: a field that is one number leaves the others' draws as they are.

    Raises:
        ValueError: a negative n, or a size that is not two positive integers.
    """
    h, w = (int(s) for s in size) if len(size) == 2 else (0, 0)
    if n < 0 or h < 1 or w < 1:
        raise ValueError(f"a shot needs n >= 0 images of at least 1 x 1 pixels; got n = {n}, size = {tuple(size)}.")
    scene.plan()  # a range that cannot be photographed is refused here, and not in the middle of a batch
    ranges = {
        (part, k): bounds(getattr(getattr(scene, part), k))
        for part in PARTS
        for k in ranged_fields(getattr(scene, part))
    }
    varied = [name for name, (low, high) in ranges.items() if low < high]
    u = torch.rand(n, len(varied) + 1, dtype=torch.float64, generator=generator)
    drawn: dict[str, dict[str, Tensor]] = {part: {} for part in PARTS}
    for (part, k), (low, high) in ranges.items():
        value = torch.full((n,), low, dtype=torch.float64)
        if (part, k) in varied:
            value = low + (high - low) * u[:, varied.index((part, k))]
            if scene.view.pose == "released" and part == "view":
                value = value.floor()  # the released code turns by whole degrees
        drawn[part][k] = value
    parts = {part: dataclasses.replace(getattr(scene, part), **drawn[part]) for part in PARTS}
    return Shot(scene=scene, size=(h, w), seed=(u[:, -1] * 2**53).to(torch.int64), **parts)
