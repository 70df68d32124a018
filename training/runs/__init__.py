"""Runs in their folders: how far they have come, what they hold, and what they report."""
