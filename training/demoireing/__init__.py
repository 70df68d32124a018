"""Demoiréing networks, trained on simulated pairs alone: `python training/demoire.py`."""
