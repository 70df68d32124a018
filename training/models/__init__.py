"""Classifiers by name. A network's module and class are part of the identity by which records of its
attacks are found again: one that moves is another model."""
