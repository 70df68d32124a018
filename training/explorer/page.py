"""The explorer's page and its second tab, in Gradio, and its server."""

from pathlib import Path

import gradio as gr

from moireaug.scene.presets import PRESETS
from moireaug.scenes import as_scene
from training.explorer import attack
from training.explorer.photograph_tab import DEFAULT_PRESET, REFUSALS, photograph_tab

HOST = "127.0.0.1"
MAX_FILE_SIZE = "20mb"
CSS = Path(__file__).with_name("page.css").read_text("utf-8")


def serve(run: str, port: int | None, *, in_browser: bool) -> None:
    """Serve the page on 127.0.0.1; return at Ctrl-C.

    Args:
        port: number of the port; None is 7860 or the next free one.

    Raises:
        OSError: the port is taken.
    """
    page(run).launch(
        server_name=HOST,
        server_port=port,
        inbrowser=in_browser,
        share=False,
        ssr_mode=False,
        max_file_size=MAX_FILE_SIZE,
        footer_links=[],
        theme=gr.themes.Default(primary_hue="blue"),
        css=CSS,
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


def attack_tab(run: str) -> None:
    """Lay out the second tab."""
    with gr.Row():
        with gr.Column(scale=2, min_width=320):
            folder = gr.Textbox(
                run, label="Folder of a run", placeholder="runs/moire_at/seed0", elem_id="run"
            )
            preset = gr.Dropdown(list(PRESETS), value=DEFAULT_PRESET, label="Scene")
            index = gr.Slider(0, attack.MAX_IMAGES - 1, 0, step=1, label="Test image", buttons=[])
            eps = gr.Slider(0.5, 16, 4, step=0.5, label="eps, in 1/255, codes", buttons=[])
            steps = gr.Slider(1, 100, 20, step=1, label="Steps", buttons=[])
            button = gr.Button("Attack", variant="primary", elem_id="attack")
        with gr.Column(scale=3, min_width=320):
            summary = gr.Markdown(
                "Each row shows the model the same image through the same shot, and adds one "
                "thing to the previous row.",
                elem_id="ladder-summary",
            )
            rows = gr.HTML(elem_id="ladder")
    button.click(show_ladder, [folder, preset, index, eps, steps], [summary, rows])


def show_ladder(
    folder: str, preset: str, index: float, eps: float, steps: float
) -> tuple[str, str]:
    """Return the ladder of one image, or the reason why there is none."""
    try:
        run = attack.open_run(folder)
        rows = attack.ladder(run, int(index), as_scene(preset), eps / 255, int(steps))
    except REFUSALS as error:
        return f"**Not possible:** {error}", ""
    label = int(run.labels[int(index)])
    right = sum(row.right for row in rows)
    summary = (
        f"The image's class is **{run.classes.get(label, label)}**. The model is right on "
        f"{right} of {len(rows)} rows."
    )
    return summary, attack.as_html(rows)
