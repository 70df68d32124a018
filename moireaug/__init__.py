"""moireaug: physical, differentiable moiré for vision models."""

from moireaug.capture import capture, develop, expose
from moireaug.plan import Plan
from moireaug.scene import Develop, Lens, Panel, Scene, Sensor, View
from moireaug.shot import Shot

__all__ = ["Develop", "Lens", "Panel", "Plan", "Scene", "Sensor", "Shot", "View", "capture", "develop", "expose"]
