"""A detector of screen photos, trained on simulated and labelled ones: what `detect.py` does."""
