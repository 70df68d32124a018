"""Demoiréing networks, trained on simulated pairs alone: `fit.py recipe=demoire`."""
