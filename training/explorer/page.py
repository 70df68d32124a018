"""The explorer's page, in Gradio. What it shows is computed elsewhere in this package."""

from __future__ import annotations

import os

# Gradio reads these when it is imported
os.environ["GRADIO_ANALYTICS_ENABLED"] = "False"
os.environ["HF_HUB_DISABLE_TELEMETRY"] = "1"

from typing import Any

import gradio as gr

from moireaug.scene.parts import PARTS
from moireaug.scene.presets import PRESETS
from moireaug.scenes import Scene
from training.explorer import attack, photo
from training.explorer.controls import CONTROLS, Control, scene_of, shown
from training.explorer.words import as_python, as_yaml

HOST = "127.0.0.1"
LARGEST_FILE = "20mb"
EXPECTED = (ValueError, TypeError, OSError)
DEFAULT, FIRST = "screen_photo", "cat"
TITLES = {
    "panel": "Panel: the screen",
    "view": "View: where the camera stands",
    "lens": "Lens",
    "sensor": "Sensor",
    "develop": "Develop: from raw to photo",
}
# the photo stays in sight while sliders are moved: beside them, or above them on a phone
CSS = """
.gradio-container {max-width: 1400px !important; margin: auto; overflow: visible !important}
.gradio-container .main, .gradio-container main > * {width: 100%}
#ladder .rungs {display: grid; gap: 16px}
#ladder .rungs {grid-template-columns: repeat(auto-fill, minmax(130px, 1fr))}
#ladder figure {margin: 0}
#ladder img {width: 100%; image-rendering: pixelated}
#ladder .wrong {font-weight: bold}
#photo img, #crop img, #spectrum img {image-rendering: pixelated}
#plan textarea {font-family: ui-monospace, Consolas, monospace; font-size: 0.85em}
@media (min-width: 769px) {
  #results {position: sticky; top: 0; align-self: flex-start}
}
@media (max-width: 768px) {
  #results {display: contents}
  #told, #photo {order: -1; width: 100%}
  #photo {position: sticky; top: 0; z-index: 1000 !important}
}
"""


def serve(run: str = "", port: int | None = None, *, in_browser: bool = False, **more: Any) -> Any:
    """Serve the page on 127.0.0.1; return at Ctrl-C.

    Args:
        run: the folder that the second tab starts with. port: None is 7860 or the next free one.
        more: further arguments of `gradio.Blocks.launch`.

    Raises:
        OSError: the port is taken.
    """
    return page(run).launch(
        server_name=HOST,
        server_port=port,
        inbrowser=in_browser,
        share=False,
        ssr_mode=False,
        max_file_size=LARGEST_FILE,
        footer_links=[],
        theme=gr.themes.Default(primary_hue="blue"),
        css=CSS,
        **more,
    )


def page(run: str = "") -> gr.Blocks:
    """Build the page."""
    with gr.Blocks(title="moireaug explorer", analytics_enabled=False) as blocks:
        gr.Markdown("# moireaug explorer\nA camera in front of a screen, effect by effect.")
        with gr.Tab("Photograph"):
            photograph_tab(blocks)
        with gr.Tab("Attack a run"):
            attack_tab(run)
    return blocks


def photograph_tab(blocks: gr.Blocks) -> None:
    """Lay out the first tab: controls at the left, what they do at the right."""
    with gr.Row():
        with gr.Column(scale=2, min_width=320):
            preset = gr.Dropdown(list(PRESETS), value=DEFAULT, label="Preset", elem_id="preset")
            sample = gr.Radio(list(photo.SAMPLES), value=FIRST, label="Picture on the screen")
            file = gr.File(label="or your own", file_types=["image"], height=130)
            with gr.Row():
                seed = gr.Number(0, label="Shot number", precision=0, minimum=0, min_width=100)
                another = gr.Button("Another shot", min_width=100)
            widgets, groups = controls(Scene.preset(DEFAULT))
        with gr.Column(scale=3, min_width=320, elem_id="results"):
            told = gr.Markdown(elem_id="told")
            view = {"interactive": False, "format": "png", "buttons": ["fullscreen"]}
            taken = gr.Image(
                label="Photo: click to choose the crop",
                elem_id="photo",
                alt_text="The picture as photographed off the screen",
                **view,
            )
            with gr.Row():
                crop = gr.Image(
                    label=f"{photo.CROP} x {photo.CROP} pixels of it",
                    elem_id="crop",
                    alt_text="A crop of the photo, magnified",
                    **view,
                )
                spectrum = gr.Image(
                    label="Spectrum, up to half a cycle per pixel",
                    elem_id="spectrum",
                    alt_text="The spectrum of the photo: moiré shows as pairs of points",
                    **view,
                )
            with gr.Tab("Plan"):
                plan = gr.Textbox(
                    show_label=False, container=False, lines=28, max_lines=40, elem_id="plan"
                )
            with gr.Tab("Milliseconds"):
                gr.Markdown(
                    "Time of each effect in the reference, on at most "
                    f"{photo.TIMED} x {photo.TIMED} pixels. The engine does them all in one pass."
                )
                cost = gr.Dataframe(
                    headers=["effect", "milliseconds"], interactive=False, max_height=1000
                )
            with gr.Tab("Python"):
                python = gr.Code(language="python", interactive=False, show_label=False)
            with gr.Tab("YAML"):
                yaml = gr.Code(language="yaml", interactive=False, show_label=False)

    inputs = [preset, sample, file, seed, *widgets]
    turned = [widget.input for widget in widgets]
    chosen = [sample.input, file.upload, file.clear, seed.input]
    named = preset.input(chosen_preset, preset, [*widgets, *groups])
    counted = another.click(lambda number: (number or 0) + 1, seed, seed)
    last = {"show_progress": "hidden", "trigger_mode": "always_last"}
    results = [told, taken, crop, spectrum, plan, python, yaml]
    for event in (
        gr.on([*turned, *chosen, blocks.load], photographed, inputs, results, **last),
        named.then(photographed, inputs, results, **last),
        counted.then(photographed, inputs, results, **last),
    ):
        event.then(timed, inputs, cost, **last)
    taken.select(cropped, taken, crop, show_progress="hidden")


def controls(scene: Scene) -> tuple[list[Any], list[Any]]:
    """Lay out the controls of a scene, part by part. Return their widgets in the order of `shown`,
    and the group that each lies in, which is hidden where the scene does not have it."""
    widgets: list[Any] = []
    groups: list[Any] = []
    for part in PARTS:
        with gr.Accordion(TITLES[part], open=part == "panel", elem_id=part):
            for control in CONTROLS:
                if control.part == part:
                    with gr.Column(visible=visible(control, scene)) as group:
                        widgets += widgets_of(control, control.read(scene))
                    groups.append(group)
    return widgets, groups


def visible(control: Control, scene: Scene) -> Any:
    """Return Gradio's word for whether a scene has a control. Hidden ones keep their values."""
    return True if control.is_for(scene) else "hidden"


def chosen_preset(name: str) -> list[Any]:
    """Return the values of all widgets for a preset, and which groups are visible."""
    scene = Scene.preset(name)
    return [*shown(scene), *(gr.update(visible=visible(one, scene)) for one in CONTROLS)]


def widgets_of(control: Control, values: list[Any]) -> list[Any]:
    """Lay out one control: two sliders for a range, else one widget."""
    label, about = control.field, control.about
    if control.kind == "switch":
        return [gr.Checkbox(values[0], label=label, info=about, elem_id=control.name)]
    if control.kind == "choice":
        named = [("none" if choice is None else str(choice), choice) for choice in control.choices]
        return [gr.Dropdown(named, value=values[0], label=label, info=about, elem_id=control.name)]
    limits = {"minimum": control.low, "maximum": control.high, "step": control.step}
    if control.kind == "number":
        return [gr.Slider(**limits, value=values[0], label=label, info=about)]
    gr.Markdown(f"**{control.field}** {about}", elem_classes="about")
    made = []
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
            made.append(slider)
    return made


def photographed(
    preset: str, sample: str, file: str | None, seed: float | None, *values: Any
) -> tuple[Any, ...]:
    """Return all that the first tab shows; if the settings are refused, return the reason and
    leave the rest unchanged."""
    try:
        scene = scene_of(values, Scene.preset(preset))
        picture = picture_of(sample, file)
        taken = photo.photograph(photo.as_batch(picture), scene, shot_number(seed))
    except EXPECTED as error:
        return f"**Not possible:** {error}", *(gr.skip() for _ in range(6))
    height, width = picture.shape[:2]
    told = f"{width} x {height} pixels, photographed in {1e3 * taken.seconds:.0f} ms."
    image = photo.as_picture(taken.photo)
    return (
        told,
        image,
        photo.magnify(image),
        photo.spectrum(image),
        str(taken.shot.plan),
        as_python(scene, preset),
        as_yaml(scene, preset),
    )


def timed(preset: str, sample: str, file: str | None, seed: float | None, *values: Any) -> Any:
    """Return the table of milliseconds; leave it unchanged if the settings are refused."""
    try:
        batch = photo.as_batch(picture_of(sample, file))
        scene = scene_of(values, Scene.preset(preset))
        found = photo.milliseconds(batch, scene, shot_number(seed))
    except EXPECTED:
        return gr.skip()
    return [[name, "in the exposure" if ms is None else f"{ms:.2f}"] for name, ms in found]


def shot_number(given: float | None) -> int:
    """Return the number of a shot, which seeds its draw; a cleared field is 0.

    Raises:
        ValueError: a number that is no seed.
    """
    number = given or 0
    if not 0 <= number < 2**53:
        raise ValueError(f"the shot number must be at least 0 and below 2^53; got {number:g}.")
    return int(number)


def picture_of(sample: str, file: str | None) -> photo.Picture:
    """Return the picture in a file, or the sample of that name.

    Raises:
        ValueError: the file is refused, see `photo.read`.
    """
    return photo.read(file) if file else photo.SAMPLES[sample]()


def cropped(image: photo.Picture, at: gr.SelectData) -> photo.Picture:
    """Return the crop around the point that was clicked."""
    x, y = at.index
    return photo.magnify(image, x / image.shape[1], y / image.shape[0])


def attack_tab(run: str) -> None:
    """Lay out the second tab."""
    with gr.Row():
        with gr.Column(scale=2, min_width=320):
            folder = gr.Textbox(
                run,
                label="Folder of a run",
                placeholder="runs/moire_at/seed0",
                elem_id="run",
            )
            preset = gr.Dropdown(list(PRESETS), value=DEFAULT, label="Scene")
            index = gr.Slider(0, attack.IMAGES - 1, 0, step=1, label="Test image", buttons=[])
            eps = gr.Slider(0.5, 16, 4, step=0.5, label="eps, in 1/255", buttons=[])
            steps = gr.Slider(1, 100, 20, step=1, label="Steps", buttons=[])
            button = gr.Button("Attack", variant="primary", elem_id="attack")
        with gr.Column(scale=3, min_width=320):
            told = gr.Markdown(
                "Each rung shows the model the same image through the same shot, and adds one "
                "thing to the previous rung.",
                elem_id="attacked",
            )
            shown_rungs = gr.HTML(elem_id="ladder")
    button.click(attacked, [folder, preset, index, eps, steps], [told, shown_rungs])


def attacked(folder: str, preset: str, index: float, eps: float, steps: float) -> tuple[str, str]:
    """Return the ladder of one image, or the reason why there is none."""
    try:
        run = attack.open_run(folder)
        found = attack.ladder(run, int(index), Scene.preset(preset), eps / 255, int(steps))
    except EXPECTED as error:
        return f"**Not possible:** {error}", ""
    label = int(run.labels[int(index)])
    right = sum(rung.right for rung in found)
    told = (
        f"The image's class is **{run.classes.get(label, label)}**. The model is right on "
        f"{right} of {len(found)} rungs."
    )
    return told, attack.as_html(found)
