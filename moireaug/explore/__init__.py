"""The explorer: a local page that photographs pictures and attacks a run's model.

Run it as `python -m moireaug.explore`. The page itself is in `page`, and needs Gradio; everything
that it shows is computed by plain functions in the other modules.
"""
