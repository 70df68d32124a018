"""The five parts of a scene: panel, view, lens, sensor, develop. Plain numbers and ranges, checked;
no tensors."""

from __future__ import annotations

import re
from dataclasses import dataclass
from numbers import Integral

from moireaug.scene.fields import Part, Range, bounds, check_number, one_of, ranged
from moireaug.scene.layout import LAYOUTS, Layout, as_layout

EXPOSURES = ("auto", "spectral", "box", "point", "mean", "supersample:4", "supersample:8")
POSES = ("camera", "released")
CFAS = ("rggb", "none")
DEMOSAICS = ("bilinear", "malvar")
DENOISERS = ("nlm", "bilateral")
RESIZES = ("area", "antialias", "point")
READINGS = ("auto", "full", "binned")
LEAST_LENS_SLOPE = 0.05  # of the radius in the photo over that in the view


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
            range. It shows only where the sensor has a `shutter`.
        duty: share of each pulse-width cycle during which the panel is on. A range.
        phase: phase of the pulses when the first sensor row starts to expose, in cycles. A range.
        black: light of a black pixel, as a share of a white pixel's. A range.
        glare: light that the glass reflects, as a share of a white screen's. A range. It has no
            subpixels, so it washes out picture and moiré alike.
        glare_x, glare_y: relative increase of the glare from the photo's centre to its right and
            lower edges. Ranges.
    """

    width: Range = ranged(0.0, 0.0, 1e5, "panel pixels")
    scale: Range = ranged(1.0, 1e-4, 1e5, "panel pixels per image pixel")
    layout: str | Layout = "rgb_stripe"
    lit: Range = ranged(1.0, 1e-3, 1.0)
    lit_x: Range = ranged(1.0, 1e-3, 1.0)
    lit_y: Range = ranged(1.0, 1e-3, 1.0)
    pwm: Range = ranged(0.0, 0.0, 1e6, "hertz")
    duty: Range = ranged(0.5, 1e-3, 1.0)
    phase: Range = ranged((0.0, 1.0), 0.0, 1.0, "cycles")
    black: Range = ranged(0.0, 0.0, 1.0)
    glare: Range = ranged(0.0, 0.0, 10.0)
    glare_x: Range = ranged(0.0, -0.5, 0.5)
    glare_y: Range = ranged(0.0, -0.5, 0.5)

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_stated("Panel.width", self.width, "Panel.scale", self.scale)
        if isinstance(self.layout, dict):
            object.__setattr__(self, "layout", as_layout(self.layout))
        if not isinstance(self.layout, Layout):
            one_of("Panel.layout", self.layout, LAYOUTS)


@dataclass(frozen=True, kw_only=True)
class View(Part):
    """Where the camera stands. All fields but `fit` and `pose` are ranges.

    The angles turn the screen about its centre: first `roll` in its plane, then `yaw`, then
    `pitch`.

    Args:
        yaw: degrees about the vertical axis; positive moves the right edge away from the camera.
        pitch: degrees about the horizontal axis; positive moves the upper edge away from the
            camera.
        roll: degrees in the image plane, counter-clockwise positive as seen in the photo.
        zoom: magnification of the picture in the photo; 1 is edge to edge when frontal.
        shift_x, shift_y: shift of the picture in the photo, as a fraction of the photo's width and
            height.
        fov: angle that the picture's diagonal spans as seen from the camera, in degrees: a small
            value is a distant camera.
        fit: move the camera back until the whole picture is in the photo, before `zoom` and the
            shifts apply; behind a strong lens, its border may reach out by 0.3 % of a side.
        pose: "camera" is a pinhole camera as described; "released" is the homography of the paper's
            released code: whole degrees, of a range all but the highest, and a focal length tied
            to the roll (`fov`, `zoom` and the shifts are not read).
    """

    yaw: Range = ranged(0.0, -89.0, 89.0, "degrees")
    pitch: Range = ranged(0.0, -89.0, 89.0, "degrees")
    roll: Range = ranged(0.0, -180.0, 180.0, "degrees")
    zoom: Range = ranged(1.0, 1e-3, 100.0)
    shift_x: Range = ranged(0.0, -1.0, 1.0)
    shift_y: Range = ranged(0.0, -1.0, 1.0)
    fov: Range = ranged(40.0, 1.0, 89.0, "degrees")
    fit: bool = True
    pose: str = "camera"

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("View.pose", self.pose, POSES)
        if self.pose == "released":
            for name in ("yaw", "pitch", "roll"):
                self._check_whole(name)

    def _check_whole(self, name: str) -> None:
        value = getattr(self, name)
        if not hasattr(value, "shape") and any(end % 1 for end in bounds(value)):
            raise ValueError(
                f"View.{name} must be in whole degrees where pose = 'released', which draws no "
                f"others; got {value!r}. Round it, or use pose = 'camera'."
            )


@dataclass(frozen=True, kw_only=True)
class Lens(Part):
    """The optics. Both coefficients map photo to ideal coordinates,
    `ideal = p (1 + k1 r^2 + k2 r^4)`, r = 1 in the photo's corners: a positive coefficient bends
    the photo like a barrel, a negative one like a pincushion.

    Args:
        k1, k2: radial distortion. Ranges.
        blur: standard deviation of the Gaussian point spread function, in sensor pixels, defocus
            included. A range.
        motion_x, motion_y: standard deviation of the motion blur of a moving hand along the
            sensor's axes, in sensor pixels. If both are given, the blur runs along a diagonal; if
            their signs differ, along the other one. It is exact for the moiré; for the picture, it
            is exact up to seven panel pixels and isotropic beyond. Ranges.
        olpf: distance between the four copies of the picture that an optical low-pass filter makes,
            along both axes, in sensor pixels; 0 is no filter. A range.
        vignetting: share of the light that is lost in the photo's corners; it falls off with the
            fourth power of the cosine. A range.
    """

    k1: Range = ranged(0.0, -1.0, 1.0)
    k2: Range = ranged(0.0, -1.0, 1.0)
    blur: Range = ranged(0.0, 0.0, 20.0, "sensor pixels")
    motion_x: Range = ranged(0.0, -20.0, 20.0, "sensor pixels")
    motion_y: Range = ranged(0.0, -20.0, 20.0, "sensor pixels")
    olpf: Range = ranged(0.0, 0.0, 4.0, "sensor pixels")
    vignetting: Range = ranged(0.0, 0.0, 0.99)

    def __post_init__(self) -> None:
        super().__post_init__()
        if hasattr(self.k1, "shape"):
            return
        for k1 in bounds(self.k1):
            for k2 in bounds(self.k2):
                # the slope of r (1 + k1 r^2 + k2 r^4) on 0..1 is least at its ends or where its own
                # slope is zero
                inner = [-3 * k1 / (10 * k2)] if k2 else []
                slopes = [1 + 3 * k1 * t + 5 * k2 * t * t for t in (1.0, *inner) if 0 <= t <= 1]
                if min(slopes) <= LEAST_LENS_SLOPE:
                    raise ValueError(
                        f"Lens.k1 = {self.k1!r}, Lens.k2 = {self.k2!r} fold the photo onto itself "
                        "before its corners: 1 + 3 k1 r^2 + 5 k2 r^4 must stay above "
                        f"{LEAST_LENS_SLOPE} for r in [0, 1], and is {min(slopes):.3g} at "
                        f"k1 = {k1:g}, k2 = {k2:g}. Bring the coefficients closer to 0."
                    )


@dataclass(frozen=True, kw_only=True)
class Sensor(Part):
    """The sensor.

    Args:
        pitch: sensor pixels per panel pixel, in the picture's centre and before it is turned; for a
            binned reading. A range; 0 leaves it to `scale`.
        scale: sensor pixels per photo pixel, along each axis. One number: it fixes the size of a
            full reading.
        reading: "full", a value for each sensor pixel; or "binned", for each photo pixel the mean
            of each colour's sensor pixels in it, interpolated bilinearly: the same photo, at a
            price that does not depend on the number of sensor pixels; see
            `moireaug.exposure.binning`. "auto" is binned where `Panel.width` or `pitch` is given.
        cfa: colour filters: "rggb", a Bayer sensor, or "none", all three colours at every pixel.
        crosstalk: share of its light that a colour filter receives from its neighbours in the
            spectrum: red and blue from green, green from both. The colour matrix undoes it for
            colours, but not for what aliases in each channel separately. A range.
        fill: width of the light-sensitive aperture, as a share of the pixel pitch. A range.
        exposure: how panel light is integrated over a sensor pixel: "spectral", the sum of the
            panel's harmonics; "box", the overlap of subpixel and aperture; "supersample:n" (n * n
            samples per pixel, n from 1 to 999); "point" (as the paper does); "mean" (only the
            panel's mean light: a screen without moiré, the control of every experiment); or "auto":
            "spectral" if harmonics of up to order 29, and at most 1024 of them, carry all contrast
            above the scene's tolerance, or if subpixels are slanted; else "box". "box" and "point"
            need rectangular subpixels.
        gain: factor on the raw reading before it saturates at 1. A range.
        shutter: exposure time of each row in seconds; 0 hides a panel's flicker. A range.
        readout: time from the first row's exposure to the last row's in a rolling shutter, in
            seconds. A range.
        read_noise: standard deviation of the Gaussian read noise, in raw units [0, 1]. A range.
        shot_noise: standard deviation of the photon noise at full scale; it grows with the square
            root of the reading. A full well of N electrons has N^-1/2. A range.
        bits: bit depth of the converter, 1 to 16; None does not round. The gradient passes straight
            through.
    """

    pitch: Range = ranged(0.0, 0.0, 1e3, "sensor pixels per panel pixel")
    scale: float = 1.0
    reading: str = "auto"
    cfa: str = "rggb"
    crosstalk: Range = ranged(0.0, 0.0, 0.3)
    fill: Range = ranged(1.0, 1e-3, 1.0)
    exposure: str = "auto"
    gain: Range = ranged(1.0, 1e-3, 1000.0)
    shutter: Range = ranged(0.0, 0.0, 3600.0, "seconds")
    readout: Range = ranged(0.0, 0.0, 3600.0, "seconds")
    read_noise: Range = ranged(0.0, 0.0, 1.0)
    shot_noise: Range = ranged(0.0, 0.0, 1.0)
    bits: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.scale, (tuple, list)):
            raise ValueError(
                "Sensor.scale must be one number, because it fixes the size of the raw reading of "
                f"a whole batch; got {self.scale!r}. Vary Sensor.pitch, Panel.scale or View.zoom "
                "instead."
            )
        scale = check_number(
            "Sensor.scale", self.scale, 0.25, 64.0, "sensor pixels per photo pixel"
        )
        object.__setattr__(self, "scale", scale)
        _check_stated("Sensor.pitch", self.pitch, "Sensor.scale", self.scale)
        one_of("Sensor.reading", self.reading, READINGS)
        if str(self.exposure).startswith("supersample"):
            if not re.fullmatch(r"supersample:[1-9]\d{0,2}", str(self.exposure)):
                raise ValueError(
                    "Sensor.exposure must be supersample:n with n from 1 to 999, to read n * n "
                    f"points; got {self.exposure!r}."
                )
        else:
            one_of("Sensor.exposure", self.exposure, EXPOSURES)
        one_of("Sensor.cfa", self.cfa, CFAS)
        if self.bits is not None and (
            isinstance(self.bits, bool)
            or not isinstance(self.bits, Integral)
            or not 1 <= self.bits <= 16
        ):
            raise ValueError(
                f"Sensor.bits must be a whole number in [1, 16], or None; got {self.bits!r}."
            )
        if self.bits is not None:
            object.__setattr__(self, "bits", int(self.bits))


@dataclass(frozen=True, kw_only=True)
class Develop(Part):
    """From raw to photo.

    Args:
        demosaic: "bilinear" (as in the paper) or "malvar" (Malvar, He and Cutler, 2004: sharper,
            and with the false colours of a real camera).
        red, blue: white-balance factors on red and blue. Ranges.
        saturation: saturation of the colour matrix, which also undoes the filters' crosstalk: 0 is
            grey, 1 the sensor's own colours. A range.
        shoulder: strength of the tone curve (1 + shoulder) x / (1 + shoulder x) on codes x, with
            which a camera lifts the midtones and rolls off the highlights; 0 is a straight line. A
            range.
        contrast: strength of the tone curve x + contrast (2 x - 1) x (1 - x), applied next: 1 is
            the smoothstep, 0 a straight line. A range.
        brighten: added to the encoded photo before it is clipped to [0, 1]. A range.
        denoise: None, "nlm" (OpenCV's non-local means, as in the paper; its gradient passes
            straight through) or "bilateral" (differentiable). It works on codes, on every sensor
            pixel.
        chroma_blur: standard deviation of the Gaussian with which a camera smooths colour, but not
            brightness, to reduce noise, in sensor pixels. A range.
        sharpen: amount of the unsharp mask on brightness; 0 is none, and negative values smooth. A
            range.
        sharpen_radius: standard deviation of the unsharp mask's Gaussian, in sensor pixels. A
            range.
        resize: how the sensor's pixels become photo pixels: "area" (box mean), "antialias"
            (triangle filter, as libraries shrink photographs; moiré as fine as a photo pixel is
            fainter) or "point" (bilinear without a prefilter, as the paper's code does).
        registered: the photo lies in the image's frame, so that labels, boxes and masks stay valid.
            A full reading's photo is warped back to it; a binned reading has its bins there.
        linear_light: the panel decodes sRGB codes into light, and the camera encodes light into
            sRGB codes.
        jpeg: quality at which the photo is compressed to JPEG, 1 to 100; 0 is no JPEG. A range, of
            which the drawn number is rounded to a whole quality, at least 1: in (0, 90), every
            photo is compressed. The values are libjpeg's, with the gradient of a differentiable
            codec.
    """

    demosaic: str = "bilinear"
    red: Range = ranged(1.0, 1e-3, 100.0)
    blue: Range = ranged(1.0, 1e-3, 100.0)
    saturation: Range = ranged(1.0, 0.0, 4.0)
    shoulder: Range = ranged(0.0, 0.0, 10.0)
    contrast: Range = ranged(0.0, -1.0, 1.0)
    brighten: Range = ranged(0.0, -1.0, 1.0)
    denoise: str | None = None
    chroma_blur: Range = ranged(0.0, 0.0, 20.0, "sensor pixels")
    sharpen: Range = ranged(0.0, -1.0, 10.0)
    sharpen_radius: Range = ranged(1.0, 0.3, 20.0, "sensor pixels")
    resize: str = "area"
    registered: bool = True
    linear_light: bool = False
    jpeg: Range = ranged(0.0, 0.0, 100.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("Develop.resize", self.resize, RESIZES)
        one_of("Develop.demosaic", self.demosaic, DEMOSAICS)
        if self.denoise is not None:
            one_of("Develop.denoise", self.denoise, DENOISERS)


def _check_stated(name: str, value: Range, other: str, other_value: Range) -> None:
    """Check a field of which 0 means that another field is read instead."""
    if hasattr(value, "shape"):
        return
    low, high = bounds(value)
    least = 1.0 if name == "Panel.width" else 1e-3
    if high and low < least:
        raise ValueError(
            f"{name} must be at least {least:g}, or 0 to read {other} instead; got {value!r}."
        )
    if high and other_value != 1.0:
        raise ValueError(
            f"{name} and {other} say the same thing in two ways; got {value!r} and "
            f"{other_value!r}. Leave one out: {other} = 1, or {name} = 0."
        )


PARTS: dict[str, type[Part]] = {
    "panel": Panel,
    "view": View,
    "lens": Lens,
    "sensor": Sensor,
    "develop": Develop,
}
