"""The parts of a shot as type checkers and editors see them: those of a scene, whose ranges are
drawn. At run time they are those of a scene."""
# mypy: disable-error-code="assignment"

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from torch import Tensor

from moireaug.scene.parts import Develop, Lens, Panel, Sensor, View

if TYPE_CHECKING:

    @dataclass(frozen=True, kw_only=True)
    class DrawnPanel(Panel):
        """A Panel of (B,) float64 tensors."""

        width: Tensor
        scale: Tensor
        lit: Tensor
        lit_x: Tensor
        lit_y: Tensor
        pwm: Tensor
        duty: Tensor
        phase: Tensor
        black: Tensor
        glare: Tensor
        glare_x: Tensor
        glare_y: Tensor

    @dataclass(frozen=True, kw_only=True)
    class DrawnView(View):
        """A View of (B,) float64 tensors."""

        yaw: Tensor
        pitch: Tensor
        roll: Tensor
        zoom: Tensor
        shift_x: Tensor
        shift_y: Tensor
        fov: Tensor

    @dataclass(frozen=True, kw_only=True)
    class DrawnLens(Lens):
        """A Lens of (B,) float64 tensors."""

        k1: Tensor
        k2: Tensor
        blur: Tensor
        motion_x: Tensor
        motion_y: Tensor
        olpf: Tensor
        vignetting: Tensor

    @dataclass(frozen=True, kw_only=True)
    class DrawnSensor(Sensor):
        """A Sensor of (B,) float64 tensors."""

        pitch: Tensor
        shrink: Tensor
        crop_x: Tensor
        crop_y: Tensor
        crosstalk: Tensor
        fill: Tensor
        gain: Tensor
        shutter: Tensor
        readout: Tensor
        read_noise: Tensor
        shot_noise: Tensor

    @dataclass(frozen=True, kw_only=True)
    class DrawnDevelop(Develop):
        """A Develop of (B,) float64 tensors."""

        red: Tensor
        blue: Tensor
        saturation: Tensor
        shoulder: Tensor
        contrast: Tensor
        brighten: Tensor
        chroma_blur: Tensor
        sharpen: Tensor
        sharpen_radius: Tensor
        jpeg: Tensor

else:
    DrawnPanel, DrawnView, DrawnLens, DrawnSensor, DrawnDevelop = Panel, View, Lens, Sensor, Develop
