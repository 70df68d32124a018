"""The panel: the screen that shows the picture."""

from __future__ import annotations

from dataclasses import dataclass

from moireaug.common.argument_checks import one_of
from moireaug.scene.fields import Part, Range, check_off_or_on, check_stated_once, ranged, varies
from moireaug.scene.layout import LAYOUTS, Layout, layout_from_dict


@dataclass(frozen=True, kw_only=True)
class Panel(Part):
    """The screen.

    Args:
        width: panel pixels across the picture's longer side, whatever the picture's size. A range;
            0 leaves it to `scale`. Panel pixels are square, so the shorter side gets fewer. Where
            they are finer than the image's, an image pixel is the mean of those that it covers.
        scale: panel pixels per image pixel, along each axis (the paper's alpha). A range. A panel
            of more pixels than the image shows it interpolated, one of fewer antialiased.
        layout: arrangement of the subpixels in a panel pixel: a key of
            `moireaug.scene.layout.LAYOUTS`, or a `Layout` with a unit cell of your own.
        lit: share of each subpixel's area that emits light; the rest is black matrix, the same
            along both axes. A range.
        lit_x, lit_y: further shares of each subpixel's width and height that emit light:
            `lit_y=0.8` leaves gaps between the rows. Ranges.
        pwm: frequency of the backlight's pulse-width modulation, in hertz; 0 is steady light. A
            range without 0. It shows only where the sensor has a `shutter`.
        duty: share of each pulse-width cycle during which the panel is on. A range.
        phase: phase of the pulses when the first sensor row starts to expose, in cycles. A range.
        black: light of a black pixel, as a share of a white pixel's. A range.
        glare: light that the glass reflects, as a share of a white screen's. A range. It has no
            subpixels, so it washes out picture and moiré alike.
        glare_x, glare_y: relative increase of the glare from the photo's centre to its right and
            lower edges. Ranges.
    """

    width: Range = ranged(0.0, 0.0, 1e5, "panel pixels", stated_from=1.0)
    scale: Range = ranged(1.0, 1e-4, 1e5, "panel pixels per image pixel")
    layout: str | Layout = "rgb_stripe"
    lit: Range = ranged(1.0, 1e-3, 1.0)
    lit_x: Range = ranged(1.0, 1e-3, 1.0)
    lit_y: Range = ranged(1.0, 1e-3, 1.0)
    pwm: Range = ranged(0.0, 0.0, 1e6, "hertz", stated_from=0.0)
    duty: Range = ranged(0.5, 1e-3, 1.0)
    phase: Range = ranged((0.0, 1.0), 0.0, 1.0, "cycles")
    black: Range = ranged(0.0, 0.0, 1.0)
    glare: Range = ranged(0.0, 0.0, 10.0)
    glare_x: Range = ranged(0.0, -0.5, 0.5)
    glare_y: Range = ranged(0.0, -0.5, 0.5)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_off_or_on(self, "pwm", "steady light")
        check_stated_once(self, "width", "scale")
        if isinstance(self.layout, dict):
            object.__setattr__(self, "layout", layout_from_dict(self.layout))
        if not isinstance(self.layout, Layout):
            one_of("Panel.layout", self.layout, LAYOUTS)

    @property
    def has_black_matrix(self) -> bool:
        """Whether a part of its subpixels may be dark."""
        return any(varies(share, 1.0) for share in (self.lit, self.lit_x, self.lit_y))

    @property
    def cell(self) -> Layout:
        """The unit cell of its subpixels, which `layout` holds or names."""
        return self.layout if isinstance(self.layout, Layout) else LAYOUTS[self.layout]
