"""Demoiréing networks, written from their papers: models to use, and defences to break.

Source of each is its module's. All have one interface, `DemoireNet`; `Demoire` puts one, or a
network of one's own, before a model.
"""

from moireaug.defenses.demoire import losses
from moireaug.defenses.demoire.base import DemoireNet
from moireaug.defenses.demoire.defence import Demoire
from moireaug.defenses.demoire.files import NETWORKS, build, load, save

__all__ = ["NETWORKS", "Demoire", "DemoireNet", "build", "load", "losses", "save"]
