"""Runs compared in one table: their shared settings, their points and the plot."""
