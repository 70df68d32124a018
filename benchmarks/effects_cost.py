"""What each effect costs, in the engine and in the reference.

    python benchmarks/effects_cost.py

The first table is of the default photo, effect by effect: what leaving out one of its own saves,
and what adding another costs. The share is of the whole default photo in the same run; none may be
above a quarter. The last rows are what every scene pays for: the exposure of a frontal screen
without subpixels, and its development.

Then every preset is built up field by field, in the order in which light meets them, from a frontal
screen at the preset's pitch or sensor scale; fields that a scene accepts only together are added
together.

Writes results/effects_cost.json. Times are of `moireaug.capture` in float32 without gradients,
shots drawn and plans made; an effect that the engine leaves to the reference says so.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import torch

from benchmarks import build_up, measure
from benchmarks.executions import EXECUTIONS, draw, in_both, taking
from benchmarks.problems import images
from moireaug import Scene, develop, expose
from moireaug.engine import program
from moireaug.scene.by_name import with_values
from moireaug.scene.presets import PRESETS

FULL = {
    "photo": (16, 224),
    "build_up": (8, 128),
    "repeats": 15,
    "warmup": 1,
    "budget": 2.0,
    "presets": len(PRESETS),
}
QUICK = {
    "photo": (1, 16),
    "build_up": (1, 8),
    "repeats": 1,
    "warmup": 0,
    "budget": 0.0,
    "presets": 2,
}
DEFAULT = "screen_photo"
MAX_SHARE = 0.25  # of the default photo, for one effect

# changes that take each effect out of the default scene
WITHOUT: dict[str, dict[str, Any]] = {
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
WITH: dict[str, dict[str, Any]] = {
    "layout of a black matrix": {"panel.lit": 0.6},
    "layout pentile": {"panel.layout": "pentile"},
    "OLPF": {"lens.olpf": 0.5},
    "vignetting": {"lens.vignetting": 0.3},
    "flicker": {"panel.pwm": 240.0, "sensor.shutter": 1 / 500, "sensor.readout": 1 / 60},
    "noise of photons": {"sensor.shot_noise": 0.01},
    "brighten": {"develop.brighten": 0.05},
    "jpeg": {"develop.jpeg": 80.0},
}
ALWAYS = ("exposure alone", "demosaic, resize")  # with all of `WITHOUT` left out


def main() -> None:
    args = measure.arguments(__doc__).parse_args()
    torch.set_num_threads(args.threads)
    facts, settings = measure.metadata(), QUICK if args.quick else FULL
    print(measure.machine_lines(facts), end="\n\n")
    photo = default_photo(settings)
    print("The default photo, {} images of {} px".format(*settings["photo"]))
    print(photo_report(photo), end="\n\n", flush=True)
    print("Presets field by field, {} images of {} px".format(*settings["build_up"]), end="\n\n")
    found = {}
    for name in list(PRESETS)[: settings["presets"]]:
        found[name] = build_up.rows_of(Scene.preset(name), settings)
        print(build_up.report(name, found[name]), end="\n\n", flush=True)
    content = {"metadata": facts, "settings": settings, "default_photo": photo, "presets": found}
    measure.write_json(measure.results(args) / "effects_cost.json", content)


@torch.no_grad()
def default_photo(settings: dict[str, Any]) -> dict[str, Any]:
    """Return the default photo's time, and a row for each effect: what it adds, in seconds an
    image."""
    shown = images("photo", *settings["photo"])
    whole = Scene.preset(DEFAULT)
    bare = whole
    for changes in WITHOUT.values():
        bare = with_values(bare, changes)
    scenes = {}
    for name, changes in (WITHOUT | WITH).items():
        scenes[name] = with_values(whole, changes)

    calls = {"whole": taking(whole, shown)}
    for name, scene in scenes.items():
        calls[name] = taking(scene, shown)
    shot = draw(bare, shown)
    raw = expose(shown, shot)
    exposure, development = ALWAYS
    calls[exposure] = lambda: expose(shown, shot)
    calls[development] = lambda: develop(raw, shot)
    times = in_both(calls, settings, len(shown))

    rows = []
    for name in WITHOUT:
        rows.append(effect_row(name, "left out", scenes[name], times))
    for name in WITH:
        rows.append(effect_row(name, "added", scenes[name], times))
    for name in ALWAYS:
        rows.append(effect_row(name, "always there", bare, times))
    seconds = {execution: times[execution]["whole"]._asdict() for execution in EXECUTIONS}
    return {"seconds": seconds, "effects": rows}


def effect_row(
    name: str, kind: str, scene: Scene, times: dict[str, dict[str, measure.Timing]]
) -> dict[str, Any]:
    """Return an effect's row, of the times of both executions: of the call of its name, and of the
    whole photo."""
    row: dict[str, Any] = {"effect": name, "kind": kind, "run_by": run_by(scene)}
    for execution in EXECUTIONS:
        whole = times[execution]["whole"].median
        taken = times[execution][name].median
        if kind == "left out":
            row[execution] = whole - taken
        elif kind == "added":
            row[execution] = taken - whole
        else:
            row[execution] = taken
    row["share"] = row["engine"] / times["engine"]["whole"].median
    return row


def run_by(scene: Scene) -> str:
    """Return the stages of a capture that the engine runs, and with which effect it leaves off."""
    parts = program.program_of(scene, scene.plan())
    why_not = {"expose": parts.why_not_expose, "develop": parts.why_not_develop}
    stages = [stage for stage, reason in why_not.items() if not reason]
    line = " and ".join(stages) or "nothing"
    if "develop" in stages and parts.reference_effects:
        line += f"; reference from {parts.reference_effects[0]!r} on"
    return line


def photo_report(photo: dict[str, Any]) -> str:
    lines = []
    for execution, seconds in photo["seconds"].items():
        median, quartiles = measure.in_ms(seconds)
        lines.append(f"{execution}: {measure.show(median)} ms a photo, quartiles {quartiles}")
    rows = []
    for row in photo["effects"]:
        share = 100 * row["share"]
        verdict = "" if share <= 100 * MAX_SHARE else f"above {100 * MAX_SHARE:g} %"
        ms = [f"{1e3 * row[execution]:+.2f}" for execution in EXECUTIONS]
        rows.append((row["effect"], row["kind"], *ms, f"{share:+.0f} %", verdict, row["run_by"]))
    columns = (
        "effect",
        "which is",
        "engine, ms",
        "reference, ms",
        "share",
        "bar",
        "the engine takes",
    )
    return "\n".join(lines) + "\n" + measure.table(columns, rows)


if __name__ == "__main__":
    main()
