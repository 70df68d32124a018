"""The room of `training/explore.py`: a local page that photographs pictures.

The page needs Gradio; its contents are computed by plain functions in the other modules."""

import os

# Gradio reads these when it is imported
os.environ["GRADIO_ANALYTICS_ENABLED"] = "False"
os.environ["HF_HUB_DISABLE_TELEMETRY"] = "1"
