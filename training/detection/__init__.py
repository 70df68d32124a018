"""A detector of screen photos, trained on simulated ones alone: what `detect.py` does."""
