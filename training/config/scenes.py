"""Scenes on a command line: a preset's name, or a YAML file of a scene or of a list of them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from moireaug.mixtures import Mixture, as_scenes
from moireaug.scenes import Scene
from training.config.schema import RunConfig, Settings
from training.config.settings import with_absolute_paths

SUFFIXES = (".yaml", ".yml")


def with_files(cfg: Settings) -> Settings:
    """Return the settings of a run with absolute paths, and the content of its scene's file."""
    cfg = with_absolute_paths(cfg)
    return replace(cfg, scene=inline_files(cfg.scene))


def inline_files(scene: Any) -> Any:
    """Return a command line's scene with the content of a YAML file in place of its name.

    A run's settings thus hold the scene itself, and no file is read again.

    Args:
        scene: a preset's name, a file's name that ends with .yaml or .yml, a mapping, or a list of
            these.
    """
    if isinstance(scene, (list, tuple)):
        several = []
        for one in map(inline_files, scene):
            several += one if isinstance(one, list) else [one]
        return several
    if isinstance(scene, str) and scene.endswith(SUFFIXES):
        return read(Path(scene))
    return scene


def scene_of(cfg: RunConfig) -> Scene | Mixture:
    """Return the scene of a run, of crops where its settings say so."""
    return as_scenes(cfg.scene, cfg.shrink)


def shrink_text(shrink: float | Sequence[float]) -> str:
    """Return a shrink, given as in the settings, as words: 2, or 1 to 3."""
    ends = shrink if isinstance(shrink, Sequence) else [shrink]
    return " to ".join(f"{end:g}" for end in ends)


def load(scene: str, shrink: Any = None) -> Scene | Mixture:
    """Return the scene of a preset's name or of a YAML file, or the mixture of a file's list or of
    a name such as "anywhere"; of crops where a shrink is given."""
    return as_scenes(inline_files(scene), shrink)


def load_one(scene: str) -> Scene:
    """Return the scene of a preset's name or of a YAML file."""
    scene_or_mixture = load(scene)
    if isinstance(scene_or_mixture, Mixture):
        raise ValueError(
            f"scene={scene} holds a list of {len(scene_or_mixture.scenes)} scenes; this command "
            "takes one at a time. Name one, or put each into a file of its own."
        )
    return scene_or_mixture


def read(path: Path) -> dict[str, Any] | list[Any]:
    """Return the content of a YAML file of a scene, or of a list of scenes, checked.

    A scene is what `Scene.from_dict` takes: its parts with the fields that differ, ranges as lists
    of two, and, with `preset`, the name of the scene to start from:

        preset: phone_at_monitor
        panel: {lit: [0.6, 0.9]}
        lens: {blur: 0.3}

    In a list, `- phone_at_monitor` is a preset, too."""
    try:
        values: Any = OmegaConf.to_container(OmegaConf.load(path))
    except OSError as error:
        reason = error.strerror or error
        raise ValueError(f"scene={path} could not be read ({reason}).") from error
    except (yaml.YAMLError, OmegaConfBaseException, ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"scene={path} could not be read as YAML: {reason}.") from error
    if not values:
        raise ValueError(
            f"scene={path} holds no scene: it must be a YAML mapping of its parts, or a list of "
            "scenes."
        )
    try:
        as_scenes(values)
    except (ValueError, TypeError) as error:
        raise ValueError(f"scene={path} holds no scene: {error}") from error
    return values
