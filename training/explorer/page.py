"""The explorer's page, in Gradio, and its server."""

from __future__ import annotations

from pathlib import Path

import gradio as gr

from training.explorer.attack_tab import attack_tab
from training.explorer.photograph_tab import photograph_tab

HOST = "127.0.0.1"
MAX_FILE_SIZE = "20mb"
CSS = Path(__file__).with_name("page.css").read_text("utf-8")


def serve(run: str, port: int | None, *, in_browser: bool) -> None:
    """Serve the page on 127.0.0.1; return at Ctrl-C.

    Args:
        run: folder of the run that the second tab starts with.
        port: number of the port; None is 7860 or the next free one.
        in_browser: whether to open a browser.

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
