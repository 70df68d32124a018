"""The development: from raw to photo."""

from __future__ import annotations

from dataclasses import dataclass

from moireaug.common.argument_checks import one_of
from moireaug.scene.fields import Part, Range, check_off_or_on, ranged

# sensor pixels to each side from which a colour is demosaiced
DEMOSAIC_REACH = {"bilinear": 1, "malvar": 2}
DENOISER_NAMES = ("nlm", "bilateral")
RESIZES = ("area", "antialias", "point")


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
            fainter) or "point" (bilinear without a prefilter, as the paper's code does, and
            `cv2.resize` and `F.interpolate` by default: what is finer than a photo pixel aliases
            once more). For one of several, drawn per image, give a list of scenes.
        registered: the photo lies in the image's frame, so that labels, boxes and masks stay valid.
            A full reading's photo is warped back to it; a binned reading has its bins there.
        linear_light: the panel decodes sRGB codes into light, and the camera encodes light into
            sRGB codes.
        jpeg: quality at which the photo is compressed to JPEG, 1 to 100; 0 is no JPEG. A range from
            1 on, of which the drawn number is rounded to a whole quality. The values are libjpeg's,
            with the gradient of a differentiable codec.
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
    jpeg: Range = ranged(0.0, 0.0, 100.0, stated_from=1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_off_or_on(self, "jpeg", "no JPEG")
        one_of("Develop.resize", self.resize, RESIZES)
        one_of("Develop.demosaic", self.demosaic, DEMOSAIC_REACH)
        if self.denoise is not None:
            one_of("Develop.denoise", self.denoise, DENOISER_NAMES)
