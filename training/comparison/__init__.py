"""Runs compared in one table: what they share, their points and the plot."""
