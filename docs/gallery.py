"""Draw the gallery: docs/gallery/*.jpg, every preset on a photograph; docs/gallery.md, with each
preset's screen and cost; and docs/banner.png.

Run it as `python docs/gallery.py`.
"""

from __future__ import annotations

import platform
import statistics
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

import torch
from matplotlib import cbook
from matplotlib.figure import Figure
from PIL import Image
from torch import Tensor
from torchvision.transforms.v2.functional import pil_to_tensor

from moireaug import Scene, Shot, capture
from moireaug.scene.presets import PRESETS
from moireaug.synthesis import without_moire

SIDE, DETAIL = 288, 72  # of the photograph, and of the part that is magnified
SEED = 3  # of all draws
CANDIDATES = 9  # draws of each preset, of which three are shown
CROP = 1.0  # sensor pixels per pixel of the crops
TIMED_BATCH, TIMED_RUNS = 16, 9
BANNER = ("screen_photo", "phone_at_laptop", "phone_at_phone", "phone_at_led_wall", "paper_code")
BANNER_CROP = (1.0, 3.0)

INTRODUCTION = f"""# Gallery

A picture of {SIDE} px in every preset. Top: whole photos (LED sign: crops) with the most, median
and least moiré of {CANDIDATES} samples. Below:
[crops](how_to_choose.md#is-my-image-a-whole-photo-or-a-crop) at the camera's resolution
(`shrink={CROP:g}`). Last, the middle of the first photo, magnified, and its moiré's spectrum.

Moiré is the median RMS difference of 8-bit values from photos without it, of nine samples;
ms is CPU time per photo of 224 px, in batches of {TIMED_BATCH}, on one thread of {{machine}}
(`python docs/gallery.py`; the portrait of Grace Hopper is in the public domain).

| preset | | whole: moiré | ms | crop: moiré | ms |
|---|---|---|---|---|---|
"""

USES = {
    "paper": "The paper's text",
    "paper_code": "The paper's released code",
    "screen_photo": "The default, an LCD",
    "phone_at_monitor": "Half a metre from a monitor",
    "phone_at_laptop": "Looking down at a laptop",
    "phone_at_phone": "A phone over another phone",
    "phone_at_television": "Near an OLED television",
    "phone_at_led_wall": "An LED wall",
    "webcam_at_phone": "A phone held up to a webcam",
    "document_camera_at_tablet": "A tablet under a document camera",
    "dashcam_at_led_sign": "A car at an LED sign",
    "phone_close_to_lcd": "So close that pixels show",
    "phone_at_whole_screen": "A laptop or monitor seen whole",
    "phone_at_tablet_by_window": "A tablet reflecting a window",
    "phone_at_dimmed_phone": "A dimmed OLED phone",
    "phone_across_room_at_television": "An LCD television across a room",
}


def photograph(side: int) -> Tensor:
    """Return matplotlib's sample photograph, a portrait in the public domain, (3, side, side)."""
    with cbook.get_sample_data("grace_hopper.jpg") as file:
        picture = Image.open(file).convert("RGB").crop((0, 0, 512, 512))
    return pil_to_tensor(picture.resize((side, side), Image.Resampling.LANCZOS)) / 255


def moire_of(pictures: Tensor, shot: Shot) -> Tensor:
    """Return what moiré adds to the photos of a shot, (B, 3, H, W)."""
    return capture(pictures, shot) - capture(pictures, without_moire(shot))


def codes(moire: Tensor) -> Tensor:
    """Return the strength of moiré (B, 3, H, W) in codes RMS, (B,)."""
    return 255 * moire.square().mean((1, 2, 3)).sqrt()


def detail(photo: Tensor) -> Tensor:
    """Return a part of a photo: the face."""
    top, left = SIDE // 4, SIDE // 2 - DETAIL // 2
    return photo[:, top : top + DETAIL, left : left + DETAIL]


def spectrum(difference: Tensor) -> Tensor:
    """Return the amplitudes of a difference's colours, (H, W, 3), on a scale of decibels."""
    window = torch.hann_window(SIDE)
    amplitude = torch.fft.fft2(difference * window * window[:, None]).abs()
    decibels = 20 * torch.fft.fftshift(amplitude, (-2, -1)).clamp(min=1e-3).log10()
    return ((decibels + 20) / 60).clamp(0, 1).permute(1, 2, 0)


def row(scene: Scene, picture: Tensor, *, by_strength: bool) -> tuple[Tensor, float]:
    """Return three photos in a scene, a detail and the spectrum of the first, (3, H, W), and the
    median strength of moiré; the photos with the strongest, middle and weakest, or the first."""
    pictures = picture.expand(CANDIDATES, -1, -1, -1)
    shot = scene.sample(CANDIDATES, (SIDE, SIDE), torch.Generator().manual_seed(SEED))
    photos, moire = capture(pictures, shot), moire_of(pictures, shot)
    strength, chosen = codes(moire), [0, 1, 2]
    if by_strength:
        order = strength.argsort(descending=True).tolist()
        chosen = [order[i] for i in (0, CANDIDATES // 2, CANDIDATES - 1)]
    first = chosen[0]
    magnified = detail(photos[first]).repeat_interleave(4, 1).repeat_interleave(4, 2)
    tiles = [*photos[chosen], magnified, spectrum(moire[first]).permute(2, 0, 1)]
    return torch.cat(tiles, 2), strength.median().item()


def ways(name: str) -> dict[str, Scene]:
    """Return a preset for whole photos and, but for the paper's, for crops."""
    scene = Scene.preset(name)
    if not scene.is_binned:
        return {"whole": scene}
    if scene.is_crop:  # which states how large a sign is in the image
        return {"crop": scene.with_shrink(CROP)}
    return {"whole": scene, "crop": scene.with_shrink(CROP)}


def draw(name: str, picture: Tensor) -> dict[str, float]:
    """Draw a preset's rows; return the strength of their moiré."""
    rows, strengths = [], {}
    for way, scene in ways(name).items():
        tiles, strengths[way] = row(scene, picture, by_strength=way == "whole")
        rows.append(tiles)
    drawn = torch.cat(rows, 1).mul(255).round().byte().permute(1, 2, 0).numpy()
    path = HERE / "gallery" / f"{name}.jpg"
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(drawn).save(path, quality=92, subsampling=0)
    return strengths


def milliseconds(scene: Scene) -> float:
    """Return the median CPU time of a photo of 224 px."""
    pictures = photograph(224).expand(TIMED_BATCH, -1, -1, -1).contiguous()
    times = []
    for _ in range(TIMED_RUNS + 1):
        shot = scene.sample(TIMED_BATCH, (224, 224))
        start = time.process_time()  # of one thread, however busy the machine is
        capture(pictures, shot)
        times.append(time.process_time() - start)
    return 1000 * statistics.median(times[1:]) / TIMED_BATCH  # the first one compiles


def figures(name: str, strengths: dict[str, float]) -> str:
    """Return a preset's row of the table: strength and time of whole photos and of crops."""
    broken = name.replace("_", "_<wbr>")  # where a phone may break it
    cells = [f"[<code>{broken}</code>](#{name})", USES[name]]
    for way in ("whole", "crop"):
        if way in strengths:
            cells += [f"{strengths[way]:.1f}", f"{milliseconds(ways(name)[way]):.1f}"]
        else:
            cells += ["", ""]
    return f"| {' | '.join(cells)} |\n"


def draw_banner(picture: Tensor) -> None:
    """Draw some presets' photos with the strongest moiré, crops but for the paper's, and their
    details."""
    figure = Figure(figsize=(2.05 * (1 + len(BANNER)), 4.3), dpi=90, layout="constrained")
    axes = figure.subplots(2, 1 + len(BANNER))
    photos = {"shown on the screen": picture}
    for name in BANNER:
        scene = Scene.preset(name)
        scene = scene.with_shrink(BANNER_CROP) if scene.is_binned else scene
        pictures = picture.expand(CANDIDATES, -1, -1, -1)
        shot = scene.sample(CANDIDATES, (SIDE, SIDE), torch.Generator().manual_seed(SEED))
        strongest = codes(moire_of(pictures, shot)).argmax()
        photos[name] = capture(pictures, shot)[strongest]
    for column, (name, photo) in zip(axes.T, photos.items(), strict=True):
        column[0].set_title(name, fontsize=10)
        for axis, part in zip(column, (photo, detail(photo)), strict=True):
            axis.imshow(part.permute(1, 2, 0).numpy(), interpolation="nearest", vmin=0, vmax=1)
            axis.set_axis_off()
    figure.savefig(HERE / "banner.png", pil_kwargs={"optimize": True})


def machine() -> str:
    """Return the processor's name."""
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return "an " + line.partition(": ")[2]
    return platform.processor()


def main() -> None:
    torch.set_num_threads(1)
    picture = photograph(SIDE)
    table, pictures = INTRODUCTION.format(machine=machine()), ""
    for name in PRESETS:
        table += figures(name, draw(name, picture))
        pictures += f"\n## {name}\n\n[![{name}](gallery/{name}.jpg)](gallery/{name}.jpg)\n"
    (HERE / "gallery.md").write_text(table + pictures)
    draw_banner(picture)


if __name__ == "__main__":
    main()
