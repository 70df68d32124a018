"""What `scene=` means: a scene, or several, of which each image is photographed in one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from moireaug.scene.draws import check_random_numbers, check_size, numbers_needed, random_numbers
from moireaug.scene.mixed_shot import MixedShot, rows_by_scene
from moireaug.scene.plan import Plan
from moireaug.scene.preset_names import MixtureName, PresetName
from moireaug.scene.presets import MIXTURES
from moireaug.scene.sized import NOMINAL_SIZE
from moireaug.scenes import Scene, Shot

OneScene = Scene | PresetName | Mapping[str, Any]


@dataclass(frozen=True)
class Mixture:
    """Two or more scenes, of which one is drawn per image, all alike; one that is named twice is
    drawn twice as often. Immutable, hashable, no tensors. `as_scenes` makes it."""

    scenes: tuple[Scene, ...]

    def sample(
        self, n: int, size: tuple[int, int], generator: torch.Generator | None = None
    ) -> MixedShot[Shot]:
        """Draw a scene and its ranges for each of `n` images of `size` (height, width); generator
        and errors as of `Scene.sample`.

        Every image takes the same number of random numbers, whichever its scene is, so the first
        rows of a larger draw are those of a smaller one.
        """
        size = check_size(size)
        return self.draw(self.random_numbers(n, generator), size)

    def random_numbers(self, n: int, generator: torch.Generator | None = None) -> Tensor:
        """Return the random numbers of `n` images: one that chooses the scene, and those of the
        scene that takes most."""
        return random_numbers(n, self._numbers_needed, generator)

    @property
    def _numbers_needed(self) -> int:
        return 1 + max(map(numbers_needed, self.scenes))

    def draw(self, u: Tensor, size: tuple[int, int]) -> MixedShot[Shot]:
        """Return the draw that `random_numbers` give of images of `size` (height, width); others
        are refused: ValueError."""
        check_random_numbers(u, self._numbers_needed)
        self.plan_effects(size)  # refuses a scene that cannot be photographed, drawn or not
        scene_index = (u[:, 0] * len(self.scenes)).long()
        parts = rows_by_scene(scene_index, len(self.scenes))
        shots = [(rows, self.draw_in(k, u[rows], size)) for k, rows in parts]
        return MixedShot.from_shots(self.scenes, scene_index, shots)

    def draw_in(self, k: int, u: Tensor, size: tuple[int, int]) -> Shot:
        """Return the shot that `random_numbers` give in scene k, of images of `size` (height,
        width)."""
        scene = self.scenes[k]
        return scene.draw(u[:, 1 : 1 + numbers_needed(scene)], size)

    def plan(self, size: tuple[int, int] = NOMINAL_SIZE) -> tuple[Plan, ...]:
        """Return the plan of each scene; errors as of `Scene.plan`."""
        return tuple(scene.plan(size) for scene in self.scenes)

    def plan_effects(self, size: tuple[int, int] = NOMINAL_SIZE) -> tuple[Plan, ...]:
        """Return `Scene.plan_effects` of each scene."""
        return tuple(scene.plan_effects(size) for scene in self.scenes)

    @property
    def moves(self) -> bool:
        """Whether points may move from image to photo: in any of the scenes."""
        return any(scene.moves for scene in self.scenes)

    def to_dict(self) -> list[dict[str, Any]]:
        """Return plain values, those of each scene; `as_scenes` is the inverse."""
        return [scene.to_dict() for scene in self.scenes]


# what every public `scene=` argument takes, see `as_scenes`
SceneLike = OneScene | Mixture | MixtureName | Sequence[OneScene]


def as_scene(scene: Scene | str | Mapping[str, Any]) -> Scene:
    """Return a Scene from a Scene, a preset's name or a mapping, such as a dict. Where several may
    be given, see `as_scenes`.

    Raises:
        ValueError: an unknown name, or a file's.
        TypeError: anything else.
    """
    if isinstance(scene, Scene):
        return scene
    if isinstance(scene, str):
        if scene.endswith((".yaml", ".yml")):
            raise ValueError(
                f"a scene's file is for the commands; got {scene!r}. Pass what it holds, "
                f"yaml.safe_load(open({scene!r}))."
            )
        return Scene.preset(scene)  # type: ignore[arg-type]
    if isinstance(scene, Mapping):
        return Scene.from_dict(scene)
    raise TypeError(
        f"scene must be a Scene, a preset's name or a dict; got {type(scene).__name__}."
    )


def as_scenes(
    scene: SceneLike | str | Sequence[Any],
    shrink: float | Sequence[float] | None = None,
) -> Scene | Mixture:
    """Return a Scene from a Scene, a preset's name or a mapping, such as a dict, and a Mixture from
    a list or tuple of two or more of these, or from the name of one in
    `moireaug.scene.presets.MIXTURES`, as every public `scene=` argument does.

    shrink: as of `Scene.with_shrink`, of every scene; None leaves the scenes as they are.

    Raises:
        ValueError: an unknown name, a file's, an empty list, or a scene that takes no shrink.
        TypeError: anything else, such as a list in a list.
    """
    if shrink is not None:
        return map_scenes(as_scenes(scene), lambda one: one.with_shrink(shrink))
    if isinstance(scene, Mixture):
        return scene
    if isinstance(scene, str) and scene in MIXTURES:
        scene = MIXTURES[scene]
    if isinstance(scene, (list, tuple)):
        if not scene:
            raise ValueError("scene names no scene, []: name one, or several to draw from.")
        for one in scene:  # a mixture within a mixture could be drawn in two ways
            if isinstance(one, (list, tuple, Mixture)):
                raise TypeError(
                    "a list of scenes must hold Scenes, presets' names or dicts; got a "
                    f"{type(one).__name__} in it. Put all scenes into one list."
                )
        found = tuple(map(as_scene, scene))
        return found[0] if len(found) == 1 else Mixture(found)
    if not isinstance(scene, (Scene, str, Mapping)):
        raise TypeError(
            "scene must be a Scene, a preset's name or a dict, or a list of these; got "
            f"{type(scene).__name__}."
        )
    return as_scene(scene)


def preset_name(scene: Scene) -> str:
    """Return the name of the preset that equals a scene, or an empty string."""
    return next((name for name in Scene.presets() if Scene.preset(name) == scene), "")


def scenes_of(scene: Scene | Mixture) -> tuple[Scene, ...]:
    """Return the scenes of a mixture, or one scene alone."""
    return scene.scenes if isinstance(scene, Mixture) else (scene,)


def map_scenes(scene: Scene | Mixture, change: Callable[[Scene], Scene]) -> Scene | Mixture:
    """Return the scene, or every scene of a mixture, changed."""
    return as_scenes([change(one) for one in scenes_of(scene)])


def sample_one(
    scene: Scene | Mixture, size: tuple[int, int], generator: torch.Generator | None = None
) -> Shot:
    """Draw for one image; in a mixture it is in one of the scenes. Arguments as of `sample`."""
    size = check_size(size)
    return draw_one(scene, scene.random_numbers(1, generator), size)


def draw_one(scene: Scene | Mixture, u: Tensor, size: tuple[int, int]) -> Shot:
    """Return the shot that the `random_numbers` of one image give, of `size` (height, width)."""
    if isinstance(scene, Scene):
        return scene.draw(u, size)
    scene.plan_effects(size)  # as in a batch
    return scene.draw_in(int(u[0, 0] * len(scene.scenes)), u, size)
