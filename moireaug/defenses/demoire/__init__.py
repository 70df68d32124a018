"""Demoiréing networks, written from their papers: models to use, and defences to break. All share
one interface, `DemoireNet`; `Demoire` puts one, or your own network, before a model."""

from moireaug.defenses.demoire import losses
from moireaug.defenses.demoire.base import Demoire, DemoireNet
from moireaug.defenses.demoire.files import NETWORKS, build, load, save

__all__ = ["NETWORKS", "Demoire", "DemoireNet", "build", "load", "losses", "save"]
