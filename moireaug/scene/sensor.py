"""The sensor."""

from __future__ import annotations

import re
from dataclasses import dataclass
from numbers import Integral

from moireaug.common.argument_checks import one_of
from moireaug.scene.fields import (
    Part,
    Range,
    check_number,
    check_off_or_on,
    check_stated_once,
    ranged,
)

EXPOSURES = ("auto", "spectral", "box", "point", "mean", "supersample:4", "supersample:8")
CFAS = ("rggb", "none")
READINGS = ("auto", "full", "binned")
MIN_PITCH = 1e-3  # sensor pixels per panel pixel
MIN_SHRINK = 0.1  # sensor pixels per photo pixel
SHORTER_SIDE = 3 / 4  # of a sensor, over its longer one
MAX_POINTS_PER_SIDE = 256  # of a photo pixel: more would take minutes


@dataclass(frozen=True, kw_only=True)
class Sensor(Part):
    """The sensor.

    Args:
        pitch: sensor pixels per panel pixel, in the picture's centre and before it is turned; for a
            binned reading. A range; 0 leaves it to `scale`.
        shrink: sensor pixels per photo pixel, along each axis: the image is a crop, a part of a
            larger photo, of which 1 is the camera's own resolution, and 4 that of a photo of 4000
            pixels sent as 1000. With `pitch`, of a screen that goes on past the image; with
            `Panel.width`, of something that has so many panel pixels, from whatever distance shows
            it at the image's size. For a binned reading. A range; 0 is a whole photo.
        pixels: sensor pixels along the longer side, four to three of the shorter; the photo that a
            crop is a part of has this size over `shrink`, or the image's if that is larger.
        focal: focal length over the sensor's longer side, which gives crops their perspective: 0.75
            is a phone's main camera, of 79 degrees across the diagonal. Whole photos have
            `View.fov`.
        crop_x, crop_y: where a crop lies in its photo: 0 at the left or upper edge, 1 at the right
            or lower one. Ranges, drawn for crops alone.
        scale: sensor pixels per photo pixel, along each axis. One number: it fixes the size of a
            full reading.
        reading: "full", a value for each sensor pixel; or "binned", for each photo pixel the mean
            of each colour's sensor pixels in it, interpolated bilinearly: the same photo, at a
            price that does not depend on the number of sensor pixels; see
            `moireaug.camera.exposure.alias_transfer`. "auto" is binned where `Panel.width`, `pitch`
            or `shrink` is given. Of more than 1024 harmonics the weakest are left out, as the plan
            then says.
        cfa: colour filters: "rggb", a Bayer sensor, or "none", all three colours at every pixel.
        crosstalk: share of its light that a colour filter receives from its neighbours in the
            spectrum: red and blue from green, green from both. The colour matrix undoes it for
            colours, but not for what aliases in each channel separately. A range.
        fill: width of the light-sensitive aperture, as a share of the pixel pitch. A range.
        exposure: how panel light is integrated over a sensor pixel: "spectral", the sum of the
            panel's harmonics; "box", the overlap of subpixel and aperture; "supersample:n" (n * n
            samples per pixel, n * scale at most 256); "point" (as the paper does; black matrix dims
            it evenly, without moiré); "mean" (only the panel's mean light: a screen without moiré,
            the control of every experiment); or "auto": "spectral" if harmonics of up to order 29,
            and at most 1024 of them, carry all contrast above the scene's tolerance, or if
            subpixels are slanted; else "box". "box" and "point" need rectangular subpixels.
        gain: factor on the raw reading before it saturates at 1. A range.
        shutter: exposure time of each row in seconds; 0 hides a panel's flicker. A range without 0.
        readout: time from the first row's exposure to the last row's in a rolling shutter, in
            seconds. A range.
        read_noise: standard deviation of the Gaussian read noise, in raw units [0, 1]. A range.
        shot_noise: standard deviation of the photon noise at full scale; it grows with the square
            root of the reading. A full well of N electrons has N^-1/2. A range.
        bits: bit depth of the converter, 1 to 16; None does not round. The gradient passes straight
            through.
    """

    pitch: Range = ranged(0.0, 0.0, 1e3, "sensor pixels per panel pixel", MIN_PITCH)
    shrink: Range = ranged(0.0, 0.0, 100.0, "sensor pixels per photo pixel", MIN_SHRINK)
    pixels: float = 4032.0
    focal: float = 0.75
    crop_x: Range = ranged((0.0, 1.0), 0.0, 1.0)
    crop_y: Range = ranged((0.0, 1.0), 0.0, 1.0)
    scale: float = 1.0
    reading: str = "auto"
    cfa: str = "rggb"
    crosstalk: Range = ranged(0.0, 0.0, 0.3)
    fill: Range = ranged(1.0, 1e-3, 1.0)
    exposure: str = "auto"
    gain: Range = ranged(1.0, 1e-3, 1000.0)
    shutter: Range = ranged(0.0, 0.0, 3600.0, "seconds", stated_from=0.0)
    readout: Range = ranged(0.0, 0.0, 3600.0, "seconds")
    read_noise: Range = ranged(0.0, 0.0, 1.0)
    shot_noise: Range = ranged(0.0, 0.0, 1.0)
    bits: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_scale()
        check_off_or_on(self, "shutter", "no flicker")
        check_stated_once(self, "pitch", "scale")
        check_stated_once(self, "shrink", "scale")
        pixels = check_number("Sensor.pixels", self.pixels, 16.0, 1e5, "sensor pixels")
        object.__setattr__(self, "pixels", pixels)
        focal = check_number("Sensor.focal", self.focal, 0.1, 100.0, "of the sensor's longer side")
        object.__setattr__(self, "focal", focal)
        one_of("Sensor.reading", self.reading, READINGS)
        self._check_exposure()
        one_of("Sensor.cfa", self.cfa, CFAS)
        self._check_bits()

    def _check_scale(self) -> None:
        if isinstance(self.scale, (tuple, list)):
            raise ValueError(
                "Sensor.scale must be one number, because it fixes the size of the raw reading of "
                f"a whole batch; got {self.scale!r}. Vary Sensor.pitch, Panel.scale or View.zoom "
                "instead."
            )
        unit = "sensor pixels per photo pixel"
        scale = check_number("Sensor.scale", self.scale, 0.25, 64.0, unit)
        object.__setattr__(self, "scale", scale)

    def _check_exposure(self) -> None:
        if not str(self.exposure).startswith("supersample"):
            one_of("Sensor.exposure", self.exposure, EXPOSURES)
            return
        most = int(MAX_POINTS_PER_SIDE / max(self.scale, 1.0))
        allowed = re.fullmatch(r"supersample:[1-9]\d{0,2}", str(self.exposure))
        if not allowed or int(str(self.exposure).partition(":")[2]) > most:
            raise ValueError(
                f"Sensor.exposure must be supersample:n with n from 1 to {most} where Sensor.scale "
                f"is {self.scale:g}, to read n * n points of each sensor pixel; got "
                f"{self.exposure!r}."
            )

    def _check_bits(self) -> None:
        if self.bits is None:
            return
        whole = isinstance(self.bits, Integral) and not isinstance(self.bits, bool)
        if not whole or not 1 <= self.bits <= 16:
            raise ValueError(
                f"Sensor.bits must be a whole number in [1, 16], or None; got {self.bits!r}."
            )
        object.__setattr__(self, "bits", int(self.bits))
