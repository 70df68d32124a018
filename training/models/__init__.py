"""Classifiers by name. A network's module and class are part of the identity that finds the records
of attacks on it: one that moves is another model."""
