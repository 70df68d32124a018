"""Runs in their folders: their identity, stage, trained weights and cost."""
