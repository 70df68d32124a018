"""Pairs of photo and original as files."""
