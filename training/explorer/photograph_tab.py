"""The first tab: a picture, photographed off a screen by the scene of the controls."""

from __future__ import annotations

from typing import Any

import gradio as gr

from moireaug.scene.presets import PRESETS
from moireaug.scenes import as_scene
from training.explorer import photo
from training.explorer.controls import scene_of
from training.explorer.scene_code import as_python, as_yaml
from training.explorer.widgets import preset_updates, scene_widgets

REFUSALS = (ValueError, TypeError, OSError)  # errors that the page shows as sentences
DEFAULT_PRESET, DEFAULT_SAMPLE = "screen_photo", "cat"


def photograph_tab(blocks: gr.Blocks) -> None:
    """Lay out the first tab: controls at the left, the photo at the right."""
    with gr.Row():
        with gr.Column(scale=2, min_width=320):
            preset = gr.Dropdown(
                list(PRESETS), value=DEFAULT_PRESET, label="Preset", elem_id="preset"
            )
            sample = gr.Radio(
                list(photo.SAMPLES), value=DEFAULT_SAMPLE, label="Picture on the screen"
            )
            file = gr.File(label="or your own", file_types=["image"], height=130)
            with gr.Row():
                seed = gr.Number(0, label="Shot number", precision=0, minimum=0, min_width=100)
                another = gr.Button("Another shot", min_width=100)
            widgets, groups = scene_widgets(as_scene(DEFAULT_PRESET))
        with gr.Column(scale=3, min_width=320, elem_id="results"):
            summary = gr.Markdown(elem_id="told")
            options = {"interactive": False, "format": "png", "buttons": ["fullscreen"]}
            image = gr.Image(
                label="Photo: click to choose the crop",
                elem_id="photo",
                alt_text="The picture as photographed off the screen",
                **options,
            )
            with gr.Row():
                crop = gr.Image(
                    label=f"{photo.CROP_SIDE} x {photo.CROP_SIDE} pixels of it",
                    elem_id="crop",
                    alt_text="A crop of the photo, magnified",
                    **options,
                )
                spectrum = gr.Image(
                    label="Spectrum, up to half a cycle per pixel",
                    elem_id="spectrum",
                    alt_text="The spectrum of the photo: moiré shows as pairs of points",
                    **options,
                )
            with gr.Tab("Plan"):
                plan = gr.Textbox(
                    show_label=False, container=False, lines=28, max_lines=40, elem_id="plan"
                )
            with gr.Tab("Milliseconds"):
                gr.Markdown(
                    "Time of each effect in the reference, on at most "
                    f"{photo.TIMED_SIDE} x {photo.TIMED_SIDE} pixels. The engine does them all in "
                    "one pass."
                )
                cost = gr.Dataframe(
                    headers=["effect", "milliseconds"], interactive=False, max_height=1000
                )
            with gr.Tab("Python"):
                python = gr.Code(language="python", interactive=False, show_label=False)
            with gr.Tab("YAML"):
                yaml = gr.Code(language="yaml", interactive=False, show_label=False)

    inputs = [preset, sample, file, seed, *widgets]
    results = [summary, image, crop, spectrum, plan, python, yaml]
    changes = [widget.input for widget in widgets]
    changes += [sample.input, file.upload, file.clear, seed.input, blocks.load]
    new_preset = preset.input(preset_updates, preset, [*widgets, *groups])
    new_seed = another.click(lambda number: (number or 0) + 1, seed, seed)
    last = {"show_progress": "hidden", "trigger_mode": "always_last"}
    for event in (
        gr.on(changes, show_photo, inputs, results, **last),
        new_preset.then(show_photo, inputs, results, **last),
        new_seed.then(show_photo, inputs, results, **last),
    ):
        event.then(show_times, inputs, cost, **last)
    image.select(show_crop, image, crop, show_progress="hidden")


def show_photo(
    preset: str, sample: str, file: str | None, seed: float | None, *values: Any
) -> tuple[Any, ...]:
    """Return all that the first tab shows; if the settings are refused, return the reason and
    leave the rest unchanged."""
    try:
        scene = scene_of(values, as_scene(preset))
        picture = picture_of(sample, file)
        result = photo.photograph(photo.as_batch(picture), scene, shot_number(seed))
    except REFUSALS as error:
        return f"**Not possible:** {error}", *(gr.skip() for _ in range(6))
    height, width = picture.shape[:2]
    summary = f"{width} x {height} pixels, photographed in {1e3 * result.seconds:.0f} ms."
    image = photo.as_picture(result.photo)
    return (
        summary,
        image,
        photo.magnify(image),
        photo.spectrum(image),
        str(result.shot.plan),
        as_python(scene, preset),
        as_yaml(scene, preset),
    )


def show_times(preset: str, sample: str, file: str | None, seed: float | None, *values: Any) -> Any:
    """Return the table of milliseconds; leave it unchanged if the settings are refused."""
    try:
        batch = photo.as_batch(picture_of(sample, file))
        scene = scene_of(values, as_scene(preset))
        times = photo.time_effects(batch, scene, shot_number(seed))
    except REFUSALS:
        return gr.skip()
    return [[name, "in the exposure" if ms is None else f"{ms:.2f}"] for name, ms in times]


def shot_number(value: float | None) -> int:
    """Return the number of a shot, which seeds its draw; a cleared field is 0.

    Raises:
        ValueError: a number that is no seed.
    """
    number = value or 0
    if not 0 <= number < 2**53:
        raise ValueError(f"the shot number must be at least 0 and below 2^53; got {number:g}.")
    return int(number)


def picture_of(sample: str, file: str | None) -> photo.Picture:
    """Return the picture in a file, or the sample of that name.

    Raises:
        ValueError: the file is refused, see `photo.read`.
    """
    return photo.read(file) if file else photo.SAMPLES[sample]()


def show_crop(image: photo.Picture, at: gr.SelectData) -> photo.Picture:
    """Return the crop around the point that was clicked."""
    x, y = at.index
    return photo.magnify(image, x / image.shape[1], y / image.shape[0])
