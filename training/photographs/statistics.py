"""Statistics of photos of screens, real or simulated alike: how strong the moiré is and at which
scale, whether it is stripes or a lattice, and how tone, sharpness and noise changed.

    rows = measure(photos, originals)    # one dict per crop
    pandas.DataFrame(rows).median()

Band-passed planes are differences of two Gaussian blurs, of the chroma R - G and B - G and of the
luma (R + G + B) / 3, in codes of 255. A band of sigma a to 2 a passes a wavelength of 6.5 a pixels
best; it is divided by its gain there, 0.47, so that such a sinusoid of amplitude A has the RMS
A / sqrt 2. The broad band, sigma 1.5 to 8, is not divided by its own, 0.85.

Flat regions are the 40 % of a crop where the original has least in the broad band of its luma.
Without an original the quietest places of the photo itself are taken, so that the moiré of luma and
the noise come out too low, and the moiré of chroma less so.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from moireaug.common.image_checks import check_images
from training.photographs import spectra
from training.photographs.tone import ColourMap, levels, psnr

Plane = NDArray[Any]  # of float32

BANDS = ((1, 2), (2, 4), (4, 8), (8, 16))  # sigmas in pixels
BROAD_BAND = (1.5, 8)  # sigmas in pixels
OCTAVE_GAIN = 4 ** (-1 / 3) - 4 ** (-4 / 3)  # of a band of sigma a to 2 a, where it is largest
FLAT_SHARE = 0.4  # share of a crop
DETAIL_SIGMA = 6  # pixels over which detail is averaged
EDGE_SHARE = 0.2  # share of a crop whose edges are compared
MIN_CROP_SIDE = 32  # pixels


class Statistic(NamedTuple):
    """The meaning of a number of `measure`.

    Args:
        title: title in tables.
        unit: unit of the number.
        small: amount that hardly matters, in that unit: two numbers are compared by
            asinh(a / small) - asinh(b / small), which is the logarithm of their ratio where they
            are large, and their difference, in units of small, where they are near 0.
        compared: whether it describes the look of photos, as a direction does not.
    """

    title: str
    unit: str
    small: float
    compared: bool = True


STATISTICS = {
    "chroma": Statistic("chroma, sigma 1.5 to 8", "codes RMS", 0.25),
    "chroma_1_2": Statistic("chroma, sigma 1 to 2", "codes RMS", 0.25),
    "chroma_2_4": Statistic("chroma, sigma 2 to 4", "codes RMS", 0.25),
    "chroma_4_8": Statistic("chroma, sigma 4 to 8", "codes RMS", 0.25),
    "chroma_8_16": Statistic("chroma, sigma 8 to 16", "codes RMS", 0.25),
    "luma": Statistic("luma, sigma 1.5 to 8", "codes RMS", 0.25),
    "luma_1_2": Statistic("luma, sigma 1 to 2", "codes RMS", 0.25),
    "luma_2_4": Statistic("luma, sigma 2 to 4", "codes RMS", 0.25),
    "luma_4_8": Statistic("luma, sigma 4 to 8", "codes RMS", 0.25),
    "luma_8_16": Statistic("luma, sigma 8 to 16", "codes RMS", 0.25),
    "peaks": Statistic("peaks of the spectrum", "per window", 0.5),
    "peak_strength": Statistic("strongest peak, strength", "codes RMS", 0.25),
    "peak_frequency": Statistic("strongest peak, frequency", "cycles/px", 0.02),
    "peak_angle": Statistic("strongest peak, direction", "degrees", 90.0, compared=False),
    "chroma_2d": Statistic("chroma: stripes 0, lattice 1", "", 0.1),
    "luma_2d": Statistic("luma: stripes 0, lattice 1", "", 0.1),
    "psnr": Statistic("PSNR", "dB", 10.0),
    "psnr_mapped": Statistic("PSNR, colours mapped", "dB", 10.0),
    "white": Statistic("white level", "codes", 20.0),
    "black": Statistic("black level", "codes", 10.0),
    "contrast": Statistic("contrast of luma", "codes RMS", 5.0),
    "saturation": Statistic("saturation", "codes", 5.0),
    "cast_red": Statistic("cast of greys, R - G", "codes", 5.0),
    "cast_blue": Statistic("cast of greys, B - G", "codes", 5.0),
    "sharpness": Statistic("gradients over the original's", "ratio", 0.1),
    "noise": Statistic("noise", "codes RMS", 0.25),
    "blocks": Statistic("blocks of 8 px", "ratio - 1", 0.05),
}


def measure(photos: Tensor, originals: Tensor | None = None) -> list[dict[str, float]]:
    """Measure every crop of a batch; computed on the CPU, without gradients.

    Args:
        photos: (B, 3, H, W) in [0, 1], at least 32 px a side.
        originals: the same crops of the pictures on the screen; None leaves out PSNR and sharpness,
            which compare with them, and takes flat and grey places from the photo itself.

    Returns:
        A dict of `STATISTICS` per crop; finite numbers.

    Raises:
        TypeError, ValueError: images outside [0, 1].
    """
    photos = check_images(photos)
    if originals is None:
        return [measure_crop(photo, None) for photo in _in_codes(photos)]
    both = zip(_in_codes(photos), _in_codes(check_images(originals)), strict=True)
    return [measure_crop(photo, original) for photo, original in both]


def _in_codes(images: Tensor) -> Iterator[Plane]:
    for image in images.detach().cpu().float():
        yield 255 * image.numpy()


def measure_crop(photo: Plane, original: Plane | None) -> dict[str, float]:
    """Measure one crop (3, H, W), in codes of 255; see `measure`."""
    reference = photo if original is None else original
    busy = busyness(reference)
    flat = busy <= np.quantile(busy, FLAT_SHARE)
    numbers = band_strengths(photo, flat)
    numbers |= spectral_statistics(photo, original, busy)
    numbers |= levels(photo, reference)
    numbers["noise"] = noise(photo, flat)
    numbers["blocks"] = blocks(photo)
    if original is not None:
        mapped = ColourMap.fit(photo, original)(photo)
        numbers["psnr"] = psnr(photo, original)
        numbers["psnr_mapped"] = psnr(mapped, original)
        numbers["sharpness"] = sharpness(mapped, original, busy)
    return {name: numbers[name] for name in STATISTICS if name in numbers}


def planes(picture: Plane) -> tuple[Plane, Plane, Plane]:
    """Return R - G, B - G and the luma of a picture (3, H, W)."""
    red, green, blue = picture
    return red - green, blue - green, (red + green + blue) / 3


def busyness(picture: Plane) -> Plane:
    """Return the amount of detail around each pixel, (H, W): the luma's broad band, blurred."""
    luma = planes(picture)[2]
    return blur(np.abs(blur(luma, BROAD_BAND[0]) - blur(luma, BROAD_BAND[1])), DETAIL_SIGMA)


def blur(plane: Plane, sigma: float) -> Plane:
    """Blur by a Gaussian, mirrored at the borders."""
    return cv2.GaussianBlur(plane, (0, 0), sigma)


def scales(plane: Plane) -> dict[float, Plane]:
    """Return every other pixel of a plane blurred by 1, 1.5, 2, 4, 8 and 16 px.

    After a blur of 4 px every other pixel holds all that is left, so that the wider ones are made
    from these."""
    blurred = {sigma: blur(plane, sigma)[::2, ::2] for sigma in (1, 1.5, 2, 4)}
    for sigma in (8, 16):
        blurred[sigma] = blur(blurred[4], math.sqrt(sigma**2 - 4**2) / 2)
    return blurred


def band_strengths(photo: Plane, flat: NDArray[np.bool_]) -> dict[str, float]:
    """Return the RMS of chroma and luma in each band, over the flat regions."""
    red, blue, luma = (scales(plane) for plane in planes(photo))
    flat = flat[::2, ::2]
    strengths = {}
    for low, high in (BROAD_BAND, *BANDS):
        name, gain = (f"_{low}_{high}", OCTAVE_GAIN) if (low, high) in BANDS else ("", 1.0)
        for kind, parts in (("chroma", (red, blue)), ("luma", (luma,))):
            square = sum(np.square((part[low] - part[high])[flat]).mean() for part in parts)
            strengths[kind + name] = math.sqrt(square) / gain
    return strengths


def spectral_statistics(photo: Plane, original: Plane | None, busy: Plane) -> dict[str, float]:
    """Return the statistics of the spectra of the flattest windows: peaks, and stripes or lattice.

    The picture's own content, in the photo's colours, is subtracted from them."""
    content = None
    if original is not None:
        content = planes(ColourMap.fit(original, photo)(original))
    photo_planes = planes(photo)
    chroma = spectra.spectrum(photo_planes[:2], content and content[:2], busy)
    luma = spectra.spectrum(photo_planes[2:], content and content[2:], busy)
    both = spectra.Spectrum(chroma.power + luma.power, chroma.floor + luma.floor)
    windows = spectra.peaks(both)
    all_peaks = [peak for window in windows for peak in window]
    strongest = max(all_peaks, key=lambda peak: peak.strength, default=spectra.Peak(0.0, 0.0, 0.0))
    return {
        "peaks": len(all_peaks) / len(windows),
        "peak_strength": strongest.strength,
        "peak_frequency": strongest.frequency,
        "peak_angle": strongest.angle,
        "chroma_2d": spectra.two_dimensionality(chroma),
        "luma_2d": spectra.two_dimensionality(luma),
    }


def sharpness(mapped: Plane, original: Plane, busy: Plane) -> float:
    """Return the RMS gradient of a photo, its colours mapped, over the original's, on the fifth of
    the crop with most detail; 1 where the original has none."""
    edges = busy >= np.quantile(busy, 1 - EDGE_SHARE)
    ours, theirs = (_gradient(planes(picture)[2])[edges].mean() for picture in (mapped, original))
    return float(math.sqrt(ours / theirs)) if theirs > 1e-6 else 1.0


def _gradient(luma: Plane) -> Plane:
    down, right = np.gradient(luma)
    return down * down + right * right


def noise(photo: Plane, flat: NDArray[np.bool_]) -> float:
    """Return the standard deviation of white noise with as much fine detail as the flat regions
    have: Immerkaer (1996), "Fast noise variance estimation", by the median."""
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    medians = [np.median(np.abs(cv2.filter2D(plane, -1, kernel)[flat])) for plane in photo]
    # the kernel's norm is 6, and half of a normal distribution lies within 0.6745
    return float(math.sqrt(np.mean(np.square(medians))) / 6 / 0.6745)


def blocks(photo: Plane) -> float:
    """Return by how much the luma's steps across the edges of 8 x 8 blocks exceed the others; the
    blocks may begin anywhere. About 0 where there are none."""
    luma = planes(photo)[2]
    excesses = []
    for axis in (0, 1):
        steps = np.abs(np.diff(luma, axis=axis)).mean(axis=1 - axis)
        steps_by_phase = np.array([steps[k::8].mean() for k in range(8)])
        median_step = float(np.median(steps_by_phase))
        excess = float(steps_by_phase.max()) / median_step - 1 if median_step > 1e-6 else 0.0
        excesses.append(excess)
    return sum(excesses) / 2


def compare(real: float, simulated: float, statistic: Statistic) -> float:
    """Return the distance of a simulated number from a real one: the logarithm of their ratio where
    both are large beside `statistic.small`, their difference in units of it where they are near
    0."""
    return math.asinh(simulated / statistic.small) - math.asinh(real / statistic.small)


def percentiles(values: Any) -> tuple[float, float, float]:
    """Return the 10th percentile, the median and the 90th percentile of some numbers."""
    low, median, high = np.percentile(np.asarray(values, dtype=np.float64), [10, 50, 90]).tolist()
    return low, median, high
