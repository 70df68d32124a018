"""A shot that moves as a hand holds it, frame by frame of a video."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from moireaug.common.argument_checks import check_real
from moireaug.scene.by_name import limits_by_name, parts_with, values_of, with_values
from moireaug.scene.draws import MAX_CACHED_SCENES
from moireaug.scene.fields import bounds
from moireaug.scene.geometry.grids import points_in_photo
from moireaug.scene.mixed_shot import MixedShot
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord

AnyShot = TypeVar("AnyShot", bound=ShotRecord | MixedShot)
WAVES = 4  # sine waves of which a motion is the sum
PEAK = math.sqrt(2 * WAVES)  # how far such a sum goes at most, of an amplitude of 1
# fields that a hand moves, and the field of `Hand` that says how far
MOVED_FIELDS = {
    "view.yaw": "turn",
    "view.pitch": "turn",
    "view.roll": "turn",
    "view.shift_x": "shift",
    "view.shift_y": "shift",
    "view.zoom": "zoom",
}


@dataclass(frozen=True, kw_only=True)
class Hand:
    """How a hand moves a camera while it films: each field of the pose by a sum of four sine waves,
    one in each quarter of the frequencies up to `frequency`, whose phases are drawn.

    Amplitudes are root mean squares over time. A field strays from where it began by at most 5.7
    times its own, and changes between frames by at most 1.8 * 2 pi * frequency / rate times it. The
    defaults are chosen, not measured: a camera that is held still.

    Args:
        turn: of yaw, pitch and roll, in degrees.
        shift: of both shifts, as a share of the photo's width and height.
        zoom: of the picture's magnification, as a share of it.
        frequency: of the fastest wave, in hertz.
        rate: frames a second.

    Raises:
        TypeError, ValueError: a field that is no number, or below 0; a `rate` of 0.
    """

    turn: float = 0.2
    shift: float = 0.003
    zoom: float = 0.002
    frequency: float = 2.0
    rate: float = 30.0

    def __post_init__(self) -> None:
        for name, unit in (("turn", "degrees"), ("shift", ""), ("zoom", ""), ("frequency", "Hz")):
            check_real(f"Hand.{name}", getattr(self, name), 0, or_low=True, unit=unit)
        check_real("Hand.rate", self.rate, 0, unit="frames a second")

    def amplitudes(self) -> np.ndarray:
        """Return the amplitude of each field in `MOVED_FIELDS`, (fields,)."""
        return np.array([getattr(self, name) for name in MOVED_FIELDS.values()])

    def motion(self, seeds: np.ndarray, seconds: np.ndarray) -> np.ndarray:
        """Return by how much each field in `MOVED_FIELDS` has moved since the first frame, (n,
        fields), a function of the seeds (n,) of the tracks and the times (n,)."""
        moved = np.empty((len(seeds), len(MOVED_FIELDS)))
        for seed in np.unique(seeds):
            rng = np.random.Generator(np.random.Philox(key=int(seed) % 2**64))
            drawn = rng.random((2, len(MOVED_FIELDS), WAVES))
            frequencies = self.frequency * (np.arange(WAVES) + drawn[0]) / WAVES
            rows = seeds == seed
            cycles = frequencies * seconds[rows, None, None] + drawn[1]
            waves = np.sin(2 * np.pi * cycles) - np.sin(2 * np.pi * drawn[1])
            moved[rows] = np.sqrt(2 / WAVES) * waves.sum(-1)
        return moved * self.amplitudes()


DEFAULT_HAND = Hand()
TRIPOD = Hand(turn=0.0, shift=0.0, zoom=0.0)


def track_of(shot: AnyShot, counts: Sequence[int], hand: Hand) -> AnyShot:
    """Return row i of a shot as counts[i] frames that a hand has filmed, (sum of counts,), one
    after another.

    Frame 0 is the row itself. Frame k has its seed + k, for sensor noise of its own; its pose,
    moved as the hand moves it in k / hand.rate seconds, which the row's seed alone decides; and the
    phase of the panel's pulses then. The scene's ranges are wider by as much as a hand moves.
    """
    if not isinstance(hand, Hand):
        raise TypeError(f"hand must be a Hand, such as Hand(turn=0.5); got {hand!r}.")
    rows = torch.from_numpy(np.repeat(np.arange(len(shot)), counts)).to(shot.device)
    frames = torch.tensor([k for n in counts for k in range(n)], device=shot.device).long()
    chosen = shot[rows]
    if isinstance(chosen, MixedShot):
        scenes = tuple(filmed_by(scene, hand) for scene in chosen.scenes)
        parts = [(rows, _filmed(part, frames[rows], hand)) for rows, part in chosen.by_scene()]
        return MixedShot.from_shots(scenes, chosen.scene_index, parts)  # type: ignore[return-value]
    return _filmed(chosen, frames, hand)  # type: ignore[return-value]


def _filmed(start: ShotRecord, frames: Tensor, hand: Hand) -> ShotRecord:
    """Return the first frames of tracks as the frames (n,) of these numbers."""
    seconds = frames.double() / hand.rate
    motion = hand.motion(start.seed.cpu().numpy(), seconds.cpu().numpy())
    numbers, scene = start.numbers(), filmed_by(start.scene, hand)
    for column, name in enumerate(MOVED_FIELDS):
        step = torch.from_numpy(motion[:, column].copy()).to(start.device)
        numbers[name] = numbers[name] + (step * numbers[name] if name == "view.zoom" else step)
    numbers["view.roll"] -= 360 * (numbers["view.roll"] / 360).round()
    numbers["panel.phase"] = (numbers["panel.phase"] + numbers["panel.pwm"] * seconds) % 1.0
    seed = start.seed + frames
    moved = dataclasses.replace(start, scene=scene, seed=seed, **parts_with(start, numbers))
    # the sensor stays as it is: nearer, it has more pixels for a panel pixel
    numbers["sensor.pitch"] = numbers["sensor.pitch"] * moved.magnification / start.magnification
    if start.scene.is_crop:  # it follows its part of the screen
        across, down = _travelled(start, moved)
        numbers["sensor.crop_x"] = numbers["sensor.crop_x"] + across
        numbers["sensor.crop_y"] = numbers["sensor.crop_y"] + down
    allowed = limits_by_name(scene)
    for name in ("sensor.pitch", "sensor.crop_x", "sensor.crop_y"):  # which follow the pose
        numbers[name] = numbers[name].clamp(*allowed[name])
    return moved.with_numbers(numbers, seed)


def _travelled(start: ShotRecord, moved: ShotRecord) -> tuple[Tensor, Tensor]:
    """Return how far crops have moved in their photos, across and down, as shares of how far they
    can, (n,) each."""
    height, width = start.whole_size
    centre = torch.tensor([width / 2, height / 2], dtype=torch.float64, device=start.device)
    points = centre.expand(len(start), 1, 2)
    there = points_in_photo(points, moved.matrix(), start.frame, start.distortion)
    photo_height, photo_width = start.photo_size
    across, down = (there[:, 0] - centre).unbind(-1)
    return across / (photo_width - width).clamp(min=1.0), down / (photo_height - height).clamp(1.0)


@functools.lru_cache(maxsize=MAX_CACHED_SCENES)
def filmed_by(scene: SceneRecord, hand: Hand) -> SceneRecord:
    """Return a scene whose ranges hold what a hand makes of its draws; one with View.pose =
    "released", and a hand that may move a field further than it goes, are refused: ValueError."""
    if not hand.amplitudes().any():
        return scene
    if scene.view.pose != "camera":
        raise ValueError(
            f"a track needs View.pose = 'camera', whose pose a hand can move by little; got "
            f"{scene.view.pose!r}. Use shot.repeat(frames) for a camera that stands still."
        )
    reach = dict(zip(MOVED_FIELDS, 2 * PEAK * hand.amplitudes(), strict=True))
    # the pitch follows the zoom, and View.fit, which keeps a turned picture in the photo
    nearer = {"view.zoom": reach["view.zoom"]}
    nearer["sensor.pitch"] = reach["view.zoom"] + math.radians(reach["view.roll"])
    values, wider = values_of(scene), {}
    for name, (low, high) in limits_by_name(scene).items():
        least, most = bounds(values[name])
        if name in nearer:
            least, most = least * (1 - nearer[name]), most * (1 + nearer[name])
        elif name in reach:
            least, most = least - reach[name], most + reach[name]
        if name == "view.roll" and (least < low or most > high):  # it goes on at the other end
            least, most = low, high
        if name in reach | nearer and (least < low or most > high):
            raise ValueError(
                f"{hand!r} may move {name} to numbers in [{least:.3g}, {most:.3g}], where "
                f"[{low:g}, {high:g}] is allowed. Lower Hand.turn, shift and zoom, or narrow the "
                f"scene's range, {values[name]!r}."
            )
        wider[name] = max(least, low), min(most, high)
    if scene.is_crop:
        wider["sensor.crop_x"] = wider["sensor.crop_y"] = 0.0, 1.0
    return with_values(scene, wider)
