"""Attacks on a trained classifier: protocol, suites and results."""
