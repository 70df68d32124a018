"""The entry points of the GPU's kernels, and the batches that they are compiled for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from moireaug import Scene
from moireaug.engine.execution import execution_of
from moireaug.engine.gpu.beat_terms import BeatTerms, beat_terms
from moireaug.engine.lower.development import lower_development
from moireaug.engine.lower.development_records import Development
from moireaug.engine.lower.exposure import lower_exposure
from moireaug.engine.lower.exposure_records import BinnedView, Exposure

DEFAULT_SCENE = "screen_photo"


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
    view: BinnedView
    development: Development
    loop_lengths: dict[str, tuple[int, ...]]


class Entry(NamedTuple):
    """A function that launches kernels.

    Args:
        call: takes the functions' module in `moireaug.engine.gpu`, and a case.
    """

    module: str
    call: Callable[[Any, Case], Any]


ENTRIES = {
    "expose": Entry("binned", lambda m, c: m.expose(c.images, c.exposure, c.view)),
    "expose, backward": Entry(
        "binned", lambda m, c: m.expose_back(c.raw, c.images, c.exposure, c.view)
    ),
    "develop": Entry("develop", lambda m, c: m.develop(c.raw, c.development)),
    "develop, backward": Entry(
        "develop", lambda m, c: m.develop_back(c.photo, c.raw, c.development)
    ),
}


def cases(batch: int, side: int) -> list[Case]:
    """Return the default scene, and one of PenTile."""
    return [
        _case(name, Scene.preset(name), batch, side) for name in (DEFAULT_SCENE, "phone_at_phone")
    ]


def prepare_on_host(batch: int, side: int) -> None:
    """Draw and lower the default scene, and choose its terms, as for one batch of photos."""
    shot = Scene.preset(DEFAULT_SCENE).sample(batch, (side, side))
    exposure, view = lower_exposure(shot, decoded=False)
    assert isinstance(view, BinnedView)
    beat_terms(exposure, view.beats)
    lower_development(shot, execution_of(shot.scene, shot.plan).engine_effects)


def _case(name: str, scene: Scene, batch: int, side: int) -> Case:
    shot = scene.sample(batch, (side, side), torch.Generator().manual_seed(0))
    images, raw = torch.zeros(batch, 3, side, side), torch.zeros(shot.raw_shape())
    effects = execution_of(shot.scene, shot.plan).engine_effects
    development = lower_development(shot, effects)
    exposure, view = lower_exposure(shot, decoded=False)
    assert isinstance(view, BinnedView)
    lengths = loop_lengths(development) | beat_loop_lengths(beat_terms(exposure, view.beats))
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
    blur = max(development.detail.chroma_size, development.detail.sharp_size)
    names = "blur_rows_kernel", "detail_kernel", "detail_back_kernel", "filter_back_kernel"
    return {name: (blur,) if blur > 1 else () for name in names}


def beat_loop_lengths(terms: BeatTerms) -> dict[str, tuple[int, ...]]:
    """Return `Case.loop_lengths` of exposing: colours, an image's harmonics and a harmonic's
    aliases, on average, and colours again."""
    harmonics = round(len(terms.harmonic) / len(terms.fits))
    lengths = (3, harmonics, round(len(terms.alias) / max(len(terms.harmonic), 1)))
    return {"expose_kernel": lengths, "expose_back_kernel": (*lengths, 3)}
