"""What each effect costs in the default photo.

    python benchmarks/effects_cost.py

A row per effect: what leaving out one of the scene's own saves, and what adding another costs. The
share is of the whole photo in the same run. The last two rows are what every scene pays for: the
exposure of a frontal screen without subpixels, and its development.

Prints the table and writes results/effects_cost.json. Times are of `moireaug.capture` in float32
without gradients, shots drawn and plans made; what the engine leaves to the reference is named.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import pandas as pd
import torch

from benchmarks import measure
from benchmarks.panels import running
from benchmarks.problems import images
from moireaug import Scene, capture, develop, expose
from moireaug.engine import execution
from moireaug.scene.by_name import with_values

# differences of a tenth of a millisecond need many rounds
FULL_SETTINGS: dict[str, Any] = {"photo": (16, 224), "repeats": 60, "warmup": 1}
QUICK_SETTINGS: dict[str, Any] = {"photo": (1, 16), "repeats": 1, "warmup": 0}
DEFAULT_SCENE = "screen_photo"

# changes that take each effect out of the default scene
REMOVED_EFFECTS: dict[str, dict[str, Any]] = {
    "decode, encode": {"develop.linear_light": False},
    "black_level": {"panel.black": 0.0},
    "layout": {"panel.layout": "even", "panel.lit_x": 1.0, "panel.lit_y": 1.0},
    "pose": {"view.yaw": 0.0, "view.pitch": 0.0, "view.roll": 0.0},
    "lens": {"lens.k1": 0.0},
    "crosstalk, colour_matrix": {"sensor.crosstalk": 0.0, "develop.saturation": 1.0},
    "glare, gain, saturate": {"panel.glare": 0.0, "sensor.gain": 1.0},
    "noise": {"sensor.read_noise": 0.0},
    "balance": {"develop.red": 1.0, "develop.blue": 1.0},
    "tone_curve": {"develop.contrast": 0.0, "develop.shoulder": 0.0},
    "chroma_blur, sharpen": {"develop.chroma_blur": 0.0, "develop.sharpen": 0.0},
}
# and changes that add others; a binned photo has no bits, no denoiser, and one way to be resized
ADDED_EFFECTS: dict[str, dict[str, Any]] = {
    "layout of a black matrix": {"panel.lit": 0.6},
    "layout pentile": {"panel.layout": "pentile"},
    "OLPF": {"lens.olpf": 0.5},
    "vignetting": {"lens.vignetting": 0.3},
    "flicker": {"panel.pwm": 240.0, "sensor.shutter": 1 / 500, "sensor.readout": 1 / 60},
    "noise of photons": {"sensor.shot_noise": 0.01},
    "brighten": {"develop.brighten": 0.05},
    "jpeg": {"develop.jpeg": 80.0},
}
CONSTANT_STAGES = ("exposure alone", "demosaic, resize")  # with all of `REMOVED_EFFECTS` left out


def main() -> None:
    args, settings, facts = measure.begin(measure.arguments(__doc__), FULL_SETTINGS, QUICK_SETTINGS)
    photo = default_photo(settings)
    print("The default photo, {} images of {} px".format(*settings["photo"]))
    print(photo_report(photo))
    measure.write_json(args, "effects_cost", metadata=facts, settings=settings, default_photo=photo)


@torch.no_grad()
def default_photo(settings: dict[str, Any]) -> dict[str, Any]:
    """Return the default photo's time, and a row for each effect: what it adds, in seconds an
    image."""
    shown = images("photo", *settings["photo"])
    whole = Scene.preset(DEFAULT_SCENE)
    bare = whole
    for changes in REMOVED_EFFECTS.values():
        bare = with_values(bare, changes)
    scenes = {}
    for name, changes in (REMOVED_EFFECTS | ADDED_EFFECTS).items():
        scenes[name] = with_values(whole, changes)

    calls = {"whole": running(capture, whole, shown)}
    for name, scene in scenes.items():
        calls[name] = running(capture, scene, shown)
    shot = bare.sample(len(shown), tuple(shown.shape[-2:]), torch.Generator().manual_seed(0))
    raw = expose(shown, shot)
    exposure, development = CONSTANT_STAGES
    calls[exposure] = lambda: expose(shown, shot)
    calls[development] = lambda: develop(raw, shot)
    times = measure.timed_together(calls, settings["repeats"], settings["warmup"])
    times = {name: time / len(shown) for name, time in times.items()}

    rows = []
    for name in REMOVED_EFFECTS:
        rows.append(effect_row(name, "left out", scenes[name], times))
    for name in ADDED_EFFECTS:
        rows.append(effect_row(name, "added", scenes[name], times))
    for name in CONSTANT_STAGES:
        rows.append(effect_row(name, "always there", bare, times))
    return {"seconds": times["whole"]._asdict(), "effects": rows}


def effect_row(
    name: str, kind: str, scene: Scene, times: dict[str, measure.Timing]
) -> dict[str, Any]:
    """Return an effect's row, of the times of the call of its name and of the whole photo."""
    whole, taken = times["whole"].median, times[name].median
    seconds = {"left out": whole - taken, "added": taken - whole, "always there": taken}[kind]
    return {
        "effect": name,
        "kind": kind,
        "run_by": run_by(scene),
        "seconds": seconds,
        "share": seconds / whole,
    }


def run_by(scene: Scene) -> str:
    """Return the stages of a capture that the engine runs, and with which effect it leaves off."""
    parts = execution.execution_of(scene, scene.plan())
    why_not = {"expose": parts.why_not_expose, "develop": parts.why_not_develop}
    stages = [stage for stage, reason in why_not.items() if not reason]
    line = " and ".join(stages) or "nothing"
    if "develop" in stages and parts.reference_effects:
        line += f"; reference from {parts.reference_effects[0]!r} on"
    return line


def photo_report(photo: dict[str, Any]) -> str:
    median, quartiles = measure.in_ms(photo["seconds"])
    rows = []
    for row in photo["effects"]:
        ms, share = f"{1e3 * row['seconds']:+.2f}", f"{100 * row['share']:+.0f} %"
        rows.append(row | {"ms": ms, "share": share})
    table = pd.DataFrame(rows)[["effect", "kind", "ms", "share", "run_by"]]
    head = f"{measure.show(median)} ms a photo, quartiles {quartiles}"
    return f"{head}\n{measure.text_of(table)}"


if __name__ == "__main__":
    main()
