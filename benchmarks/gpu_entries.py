"""The entry points of the GPU's kernels, and the batches that they are compiled for."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from moireaug import Lens, Panel, Scene, Sensor, View
from moireaug.engine.gpu.beat_terms import BeatTerms, beat_terms
from moireaug.engine.lower.development import lower_development
from moireaug.engine.lower.development_records import Development
from moireaug.engine.lower.exposure import lower_exposure
from moireaug.engine.lower.exposure_records import BinnedView, Exposure, PanelView, PointView

DEFAULT = "screen_photo"


class Case(NamedTuple):
    """A batch of a scene: what entry points take. Only the shapes of its tensors matter.

    Args:
        loop_lengths: of a kernel's loops, by its name, in the order in which they begin.
    """

    name: str
    images: Tensor
    raw: Tensor
    photo: Tensor
    exposure: Exposure
    view: PanelView
    development: Development
    loop_lengths: dict[str, tuple[int, ...]]


class Entry(NamedTuple):
    """A function that launches kernels.

    Args:
        call: takes the functions' module in `moireaug.engine.gpu`, and a case.
        reading: the cases that it takes, by the name of what exposes them; "" for all.
    """

    module: str
    call: Callable[[Any, Case], Any]
    reading: str = ""


ENTRIES = {
    "expose": Entry("binned", lambda m, c: m.expose(c.images, c.exposure, c.view), "binned"),
    "expose, backward": Entry(
        "binned", lambda m, c: m.expose_back(c.raw, c.images, c.exposure, c.view), "binned"
    ),
    "expose, full": Entry("full", lambda m, c: m.expose(c.images, c.exposure, c.view), "full"),
    "expose, full, backward": Entry(
        "full", lambda m, c: m.expose_back(c.raw, c.images, c.exposure, c.view), "full"
    ),
    "expose, point": Entry("full", lambda m, c: m.expose(c.images, c.exposure, c.view), "point"),
    "expose, point, backward": Entry(
        "full", lambda m, c: m.expose_back(c.raw, c.images, c.exposure, c.view), "point"
    ),
    "develop": Entry("develop", lambda m, c: m.develop(c.raw, c.development)),
    "develop, backward": Entry(
        "develop", lambda m, c: m.develop_back(c.photo, c.raw, c.development)
    ),
}


def reading_of(case: Case) -> str:
    """Return what exposes a case: "point", "binned" or "full"."""
    if isinstance(case.view, PointView):
        return "point"
    return "binned" if isinstance(case.view, BinnedView) else "full"


def cases(batch: int, side: int) -> list[Case]:
    """Return the default scene, whose readings are binned, one of PenTile, one of full readings, of
    a Bayer sensor, from the side, through a lens, and the paper's, of points."""
    default = Scene.preset(DEFAULT)
    full = dataclasses.replace(
        default,
        panel=Panel(scale=3.0, lit=0.7),
        view=View(yaw=(-20.0, 20.0)),
        lens=Lens(blur=0.5, k1=(-0.05, 0.05)),
        sensor=Sensor(scale=2.0, reading="full", crosstalk=(0.1, 0.25), gain=2.0),
        develop=dataclasses.replace(default.develop, chroma_blur=1.5, sharpen_radius=1.0),
    )
    scenes = {DEFAULT: default, "phone_at_phone": Scene.preset("phone_at_phone"), "full": full}
    scenes["paper_code"] = Scene.preset("paper_code")
    return [_case(name, scene, batch, side) for name, scene in scenes.items()]


def prepare_on_host(batch: int, side: int) -> None:
    """Draw and lower the default scene, and choose its terms, as for one batch of photos."""
    shot = Scene.preset(DEFAULT).sample(batch, (side, side))
    exposure, view = lower_exposure(shot, decoded=False)
    assert isinstance(view, BinnedView)
    beat_terms(exposure, view.beats)
    lower_development(shot)


def _case(name: str, scene: Scene, batch: int, side: int) -> Case:
    shot = scene.sample(batch, (side, side), torch.Generator().manual_seed(0))
    images, raw = torch.zeros(batch, 3, side, side), torch.zeros(shot.raw_shape())
    development = lower_development(shot)
    exposure, view = lower_exposure(shot, decoded=False)
    lengths = loop_lengths(development)
    if isinstance(view, BinnedView):
        lengths |= beat_loop_lengths(beat_terms(exposure, view.beats))
    return Case(
        name,
        images,
        raw,
        torch.zeros_like(images),
        exposure,
        view,
        development,
        lengths,
    )


def loop_lengths(development: Development) -> dict[str, tuple[int, ...]]:
    """Return `Case.loop_lengths`. Loops of length 1 are not compiled."""
    codes, detail = development.codes, development.detail
    blur = max(detail.chroma_size, detail.sharp_size)
    axes = detail.rows, detail.cols, codes.rows, codes.cols
    taps, photo_pixels = [axis.tap_count for axis in axes], [axis.target_count for axis in axes]
    lengths = {
        "develop_kernel": taps[2:],
        "blur_rows_kernel": [blur],
        "detail_kernel": [*taps[:2], blur],
        "detail_back_kernel": [blur, *photo_pixels[:2]],
        "filter_back_kernel": [blur],
        "light_back_kernel": photo_pixels[2:],
    }
    long = {name: tuple(n for n in some if n > 1) for name, some in lengths.items()}
    return long | {"demosaic_back_kernel": (4, 1, 1)}  # planes; folds, which few tiles have


def beat_loop_lengths(terms: BeatTerms) -> dict[str, tuple[int, ...]]:
    """Return `Case.loop_lengths` of binned readings: colours, an image's harmonics and a harmonic's
    aliases, on average, and colours again."""
    harmonics = round(len(terms.harmonic) / len(terms.fits))
    lengths = (3, harmonics, round(len(terms.alias) / max(len(terms.harmonic), 1)))
    return {"expose_kernel": lengths, "expose_back_kernel": (*lengths, 3)}
