"""The explorer's page, in Gradio, and its server."""

from pathlib import Path

import gradio as gr

from training.explorer.layout import lay_out

HOST = "127.0.0.1"
MAX_FILE_SIZE = "20mb"
CSS = Path(__file__).with_name("page.css").read_text("utf-8")


def serve(port: int | None, *, in_browser: bool) -> None:
    """Serve the page on 127.0.0.1; return at Ctrl-C.

    Args:
        port: number of the port; None is 7860 or the next free one.

    Raises:
        OSError: the port is taken.
    """
    page().launch(
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


def page() -> gr.Blocks:
    """Build the page."""
    with gr.Blocks(title="moireaug explorer", analytics_enabled=False) as blocks:
        gr.Markdown("# moireaug explorer\nA camera in front of a screen, effect by effect.")
        lay_out(blocks)
    return blocks
