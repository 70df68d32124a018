"""The room of `training/explore.py`: a local page that photographs pictures and attacks a run's
model.

The page itself is in `page`, and needs Gradio; everything that it shows is computed by plain
functions in the other modules.
"""
