"""The page's layout: a picture, photographed off a screen, and the controls of the scene."""

from typing import Any

import gradio as gr

from moireaug.scene.parts import PARTS
from moireaug.scene.presets import PRESETS
from moireaug.scenes import Scene, as_scene
from training.explorer import photo
from training.explorer.controls import CONTROLS, Control, scene_of, values_of
from training.explorer.scene_code import as_python, as_yaml

PART_TITLES = {
    "panel": "Panel: the screen",
    "view": "View: where the camera stands",
    "lens": "Lens",
    "sensor": "Sensor",
    "develop": "Develop: from raw to photo",
}
REFUSALS = (ValueError, TypeError, OSError)  # errors that the page shows as sentences
DEFAULT_PRESET, DEFAULT_SAMPLE = "screen_photo", "cat"


def scene_widgets(scene: Scene) -> tuple[list[Any], list[Any]]:
    """Lay out the controls of a scene, part by part. Return their widgets in the order of
    `values_of`, and the group of each control."""
    widgets: list[Any] = []
    groups: list[Any] = []
    for part in PARTS:
        with gr.Accordion(PART_TITLES[part], open=part == "panel", elem_id=part):
            for control in CONTROLS:
                if control.part == part:
                    with gr.Column() as group:
                        widgets += widgets_of(control, control.read(scene))
                    groups.append(group)
    return widgets, groups


def preset_updates(name: str) -> list[Any]:
    """Return the values of all widgets for a preset, and which groups are visible; hidden ones keep
    their values."""
    scene = as_scene(name)
    updates = []
    for control in CONTROLS:
        updates.append(gr.update(visible=control.applies_to(scene) or "hidden"))
    return [*values_of(scene), *updates]


def widgets_of(control: Control, values: list[Any]) -> list[Any]:
    """Lay out one control: two sliders for a range, else one widget."""
    label, info = control.field, control.description
    if control.kind == "switch":
        return [gr.Checkbox(values[0], label=label, info=info, elem_id=control.name)]
    if control.kind == "choice":
        choices = [
            ("none" if choice is None else str(choice), choice) for choice in control.choices
        ]
        return [gr.Dropdown(choices, value=values[0], label=label, info=info, elem_id=control.name)]
    limits = {"minimum": control.low, "maximum": control.high, "step": control.step}
    if control.kind == "number":
        return [gr.Slider(**limits, value=values[0], label=label, info=info)]
    gr.Markdown(f"**{control.field}** {info}", elem_classes="about")
    sliders: list[Any] = []
    with gr.Row():
        for end, value in zip(("from", "to"), values, strict=True):
            slider = gr.Slider(
                **limits,
                value=value,
                label=f"{label}, {end}",
                min_width=180,
                buttons=[],
                elem_id=f"{control.name}-{end}".replace(".", "-"),
            )
            sliders.append(slider)
    return sliders


def lay_out(blocks: gr.Blocks) -> None:
    """Lay out controls at the left, and the photo at the right."""
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
            summary = gr.Markdown(elem_id="summary")
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
            with gr.Tab("Python"):
                python = gr.Code(language="python", interactive=False, show_label=False)
            with gr.Tab("YAML"):
                yaml = gr.Code(language="yaml", interactive=False, show_label=False)

    inputs = [preset, sample, file, seed, *widgets]
    results = [summary, image, crop, spectrum, plan, python, yaml]
    changes = [widget.input for widget in widgets]
    changes += [sample.input, file.upload, file.clear, seed.input]
    shown = [preset.input, blocks.load]  # Gradio hides no group before the page is there
    new_preset = gr.on(shown, preset_updates, preset, [*widgets, *groups])
    new_seed = another.click(lambda number: (number or 0) + 1, seed, seed)
    last = {"show_progress": "hidden", "trigger_mode": "always_last"}
    gr.on(changes, show_photo, inputs, results, **last)
    for event in (new_preset, new_seed):
        event.then(show_photo, inputs, results, **last)
    image.select(show_crop, image, crop, show_progress="hidden")


def show_photo(
    preset: str, sample: str, file: str | None, seed: float | None, *values: Any
) -> tuple[Any, ...]:
    """Return all that the page shows; if the settings are refused, return the reason and
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
        str(scene.plan((height, width))),
        as_python(scene, preset),
        as_yaml(scene, preset),
    )


def shot_number(value: float | None) -> int:
    """Return the number of a shot, which seeds its draw; a cleared field is 0."""
    number = value or 0
    if not 0 <= number < 2**53:
        raise ValueError(f"the shot number must be at least 0 and below 2^53; got {number:g}.")
    return int(number)


def picture_of(sample: str, file: str | None) -> photo.Picture:
    """Return the picture in a file, or the sample of that name."""
    return photo.read(file) if file else photo.SAMPLES[sample]()


def show_crop(image: photo.Picture, at: gr.SelectData) -> photo.Picture:
    """Return the crop around the point that was clicked."""
    x, y = at.index
    return photo.magnify(image, x / image.shape[1], y / image.shape[0])
