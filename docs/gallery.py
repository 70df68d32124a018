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
CANDIDATES = 9  # draws of each preset, of which three are shown
TIMED_BATCH, TIMED_RUNS = 16, 9
BANNER = ("screen_photo", "phone_at_monitor", "phone_at_phone", "phone_at_led_wall", "paper_code")

INTRODUCTION = f"""# Gallery

One photograph of {SIDE} px in every preset: of {CANDIDATES} draws, the photos with the strongest,
middle and weakest moiré; a part of the first, magnified; the spectrum of its moiré.
Milliseconds are per photo of 224 px on one thread of {{machine}}. `python docs/gallery.py` draws
this page; the portrait of Grace Hopper is in the public domain.
"""

USES = {
    "paper": "The paper's text, section 3.3",
    "paper_code": "The paper's released code",
    "screen_photo": "A phone in front of an LCD: the default",
    "phone_at_monitor": "A phone in the hand, half a metre from a desk monitor",
    "phone_at_laptop": "A phone looking down at a laptop",
    "phone_at_phone": "A phone over another phone",
    "phone_at_television": "A phone near an OLED television",
    "phone_at_led_wall": "A phone in front of an LED wall",
    "webcam_at_phone": "A phone held in front of a webcam, as in an identity check",
    "document_camera_at_tablet": "A tablet under a document camera",
    "dashcam_at_led_sign": "A car drives up to a full-colour LED sign",
    "phone_close_to_lcd": "A phone close to an LCD, whose pixels are seen",
    "phone_at_whole_screen": "A laptop or monitor seen whole, in a room",
    "phone_at_tablet_by_window": "A tablet at an angle, reflecting a window",
    "phone_at_dimmed_phone": "An OLED phone turned down in the dark",
    "phone_across_room_at_television": "An LCD television from across a room",
}


def photograph(side: int) -> Tensor:
    """Return matplotlib's sample photograph, a portrait in the public domain, (3, side, side)."""
    with cbook.get_sample_data("grace_hopper.jpg") as file:
        picture = Image.open(file).convert("RGB").crop((0, 0, 512, 512))
    return pil_to_tensor(picture.resize((side, side), Image.Resampling.LANCZOS)) / 255


def moire_of(pictures: Tensor, shot: Shot) -> Tensor:
    """Return what moiré adds to the photos of a shot, (B, 3, H, W)."""
    return capture(pictures, shot) - capture(pictures, without_moire(shot))


def ordered(pictures: Tensor, shot: Shot) -> list[int]:
    """Return the draws of a shot by the strength of their moiré, strongest first."""
    strength = moire_of(pictures, shot).square().mean((1, 2, 3))
    return strength.argsort(descending=True).tolist()


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


def draw(name: str, picture: Tensor) -> None:
    """Draw a preset's photos, the detail and the spectrum in a row."""
    pictures = picture.expand(CANDIDATES, -1, -1, -1)
    shot = Scene.preset(name).sample(CANDIDATES, (SIDE, SIDE), torch.Generator().manual_seed(3))
    order = ordered(pictures, shot)
    photos = capture(pictures, shot)
    shown = [photos[order[i]] for i in (0, CANDIDATES // 2, CANDIDATES - 1)]
    magnified = detail(shown[0]).repeat_interleave(4, 1).repeat_interleave(4, 2)
    difference = moire_of(pictures, shot)[order[0]]
    tiles = [*shown, magnified, spectrum(difference).permute(2, 0, 1)]
    row = torch.cat(tiles, 2).mul(255).round().byte().permute(1, 2, 0).numpy()
    path = HERE / "gallery" / f"{name}.jpg"
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(row).save(path, quality=92, subsampling=0)


def milliseconds(name: str) -> float:
    """Return the median time of a photo of 224 px."""
    pictures = photograph(224).expand(TIMED_BATCH, -1, -1, -1).contiguous()
    times = []
    for _ in range(TIMED_RUNS + 1):
        shot = Scene.preset(name).sample(TIMED_BATCH, (224, 224))
        start = time.perf_counter()
        capture(pictures, shot)
        times.append(time.perf_counter() - start)
    return 1000 * statistics.median(times[1:]) / TIMED_BATCH  # the first one compiles


def section(name: str) -> str:
    """Return a preset's part of the page."""
    return (
        f"\n## {name}\n\n{USES[name]}; {milliseconds(name):.1f} ms.\n\n"
        f"[![{name}](gallery/{name}.jpg)](gallery/{name}.jpg)\n"
    )


def draw_banner(picture: Tensor) -> None:
    """Draw some presets' strongest photo, and its detail."""
    figure = Figure(figsize=(2.05 * (1 + len(BANNER)), 4.3), dpi=90, layout="constrained")
    axes = figure.subplots(2, 1 + len(BANNER))
    photos = {"shown on the screen": picture}
    for name in BANNER:
        pictures = picture.expand(CANDIDATES, -1, -1, -1)
        shot = Scene.preset(name).sample(CANDIDATES, (SIDE, SIDE), torch.Generator().manual_seed(3))
        photos[name] = capture(pictures, shot)[ordered(pictures, shot)[0]]
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
    page = INTRODUCTION.format(machine=machine())
    for name in PRESETS:
        draw(name, picture)
        page += section(name)
    (HERE / "gallery.md").write_text(page)
    draw_banner(picture)


if __name__ == "__main__":
    main()
