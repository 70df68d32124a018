"""Attacks on a trained classifier: the protocol, and what suites need besides."""
