"""The widgets of a scene's controls, in Gradio."""

from __future__ import annotations

from typing import Any

import gradio as gr

from moireaug.scene.parts import PARTS
from moireaug.scenes import Scene, as_scene
from training.explorer.controls import CONTROLS, Control, values_of

PART_TITLES = {
    "panel": "Panel: the screen",
    "view": "View: where the camera stands",
    "lens": "Lens",
    "sensor": "Sensor",
    "develop": "Develop: from raw to photo",
}


def scene_widgets(scene: Scene) -> tuple[list[Any], list[Any]]:
    """Lay out the controls of a scene, part by part. Return their widgets in the order of
    `values_of`, and the group of each control, which is hidden where the scene does not have it."""
    widgets: list[Any] = []
    groups: list[Any] = []
    for part in PARTS:
        with gr.Accordion(PART_TITLES[part], open=part == "panel", elem_id=part):
            for control in CONTROLS:
                if control.part == part:
                    with gr.Column(visible=visible(control, scene)) as group:
                        widgets += widgets_of(control, control.read(scene))
                    groups.append(group)
    return widgets, groups


def visible(control: Control, scene: Scene) -> Any:
    """Return Gradio's word for whether a scene has a control. Hidden ones keep their values."""
    return True if control.applies_to(scene) else "hidden"


def preset_updates(name: str) -> list[Any]:
    """Return the values of all widgets for a preset, and which groups are visible."""
    scene = as_scene(name)
    updates = [gr.update(visible=visible(control, scene)) for control in CONTROLS]
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
