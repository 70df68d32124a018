"""The Moiré Attack: noise on the raw reading of a photographed screen."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from moireaug.attacks.checks import check_count, check_goals
from moireaug.attacks.loop import Attack
from moireaug.attacks.mixed import as_one, by_scene, drawn_shot
from moireaug.attacks.pose import aim, moved_fields, pose_of
from moireaug.attacks.problem import Problem, Result, single
from moireaug.capture import develop, expose
from moireaug.mixed_shot import MixedShot, in_order
from moireaug.mixtures import Mixture, as_scenes, scenes_of
from moireaug.numeric import clip
from moireaug.scene.fields import one_of
from moireaug.scenes import Scene, Shot
from moireaug.shot import ShotRecord

Stage = Callable[[Tensor, ShotRecord], Tensor]

# where noise is added: what comes before it, and what after
NOISE_AT: dict[str, tuple[Stage, Stage]] = {
    "raw": (expose, develop),
    "photo": (
        lambda images, shot: develop(expose(images, shot), shot),
        lambda photo, shot: clip(photo),
    ),
}


@dataclass(frozen=True, kw_only=True)
class MoireAttack(Attack):
    """The Moiré Attack (paper, section 3 and Algorithm 1): find delta on the raw reading so that
    the developed photo `develop(expose(x) + delta)` is misclassified, or classified as a target.

    The screen is exposed once; every step only develops raw + delta. Unlike the printed algorithm,
    each step's photo is developed from the one reading plus the current delta, and the best step
    per image is returned. The printed order is the rule "printed", whose noise is larger than eps:
    see `rules.Printed`.

    If the adversary also moves the camera, every step exposes the screen again. The Result's shot
    is then the one found. As always with noise at "raw", `capture(images, result.shot,
    result.noise)` is its photo.

    Args:
        scene: a Scene, a preset's name or a dict, or a list of these, a mixture: each image is then
            photographed in one of them, and the images of each scene are attacked together, as a
            batch of their own. `Result` says what is joined how.
        eot: shots per step; above 1, each step averages over that many fresh draws of the scene
            (expectation over transformation; of a mixture, of the image's own scene), and the noise
            found is judged on `shot` alone. 1 attacks `shot` itself.
        noise_at: a key of `NOISE_AT`: "raw", or "photo", on the finished photo, which is then
            clipped to [0, 1]: the paper's Moiré + BIM (appendix E).
        optimise: what moves: "noise", and parts of the scene ("panel", "view", "lens", "sensor",
            "develop"), whose ranges are all searched within the scene's bounds by the same steps,
            with sizes in units of half a range's width. The search starts at the drawn shot, a
            restart at a fresh draw. ("view",) searches for the worst pose without noise. A field
            that no effect of the plan reads stays where it is. All scenes of a mixture must allow
            it.
        others: see `Attack`.

    Raises:
        ValueError: settings out of range or that exclude one another; an `optimise` that this
            scene, or the shot of a call, does not allow: an exposure without a gradient in the shot
            ("spectral", "box" and "mean" have one), a pose in whole degrees, no range. A model
            without an answer to any of a batch's images; in a mixture, to any of a scene's.
    """

    scene: Scene | Mixture | str | dict | list | tuple = "screen_photo"
    eot: int = 1
    noise_at: str = "raw"
    optimise: tuple[str, ...] = ("noise",)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "scene", as_scenes(self.scene))
        check_count("eot", self.eot, 1, "the shots per step")
        if self.until_fooled and self.eot > 1:
            raise ValueError(
                f"until_fooled asks whether one shot is fooled: it needs eot = 1; got {self.eot}."
            )
        one_of("noise_at", self.noise_at, NOISE_AT)
        parts = self.optimise
        if not isinstance(parts, (tuple, list)) or not parts or len(set(parts)) < len(parts):
            raise ValueError(
                "optimise must be a tuple of different names, like ('noise', 'view'); got "
                f"{self.optimise!r}."
            )
        object.__setattr__(self, "optimise", tuple(self.optimise))
        for one in scenes_of(as_scenes(self.scene)):
            moved_fields(one, self.optimise)
        if self.rule == "printed" and (self.eot > 1 or self.optimise != ("noise",)):
            raise ValueError(
                "the rule 'printed' adds to the reading of one shot: it needs eot = 1 and optimise "
                f"= ('noise',); got eot = {self.eot} and optimise = {self.optimise!r}. Use 'sign'."
            )

    def __call__(
        self,
        images: Tensor,
        labels: Tensor,
        targets: Tensor | None = None,
        *,
        shot: Shot | MixedShot | None = None,
        generator: torch.Generator | None = None,
    ) -> Result | list[Result]:
        """Attack a batch; see `Attack`. A shot of one scene is attacked in that scene."""
        attack = partial(super().__call__, generator=generator)
        drawn = drawn_shot(as_scenes(self.scene), images, shot, generator)
        if not isinstance(drawn, MixedShot):
            return attack(images, labels, targets, shot=drawn)
        goals = check_goals(images, labels, targets)
        return as_one(drawn, by_scene(drawn, images, goals, attack), self.noise_at)

    def toward(
        self,
        images: Tensor,
        labels: Tensor,
        classes: Tensor,
        *,
        shot: Shot | MixedShot | None = None,
        generator: torch.Generator | None = None,
        problem: Problem | None = None,
    ) -> Result:
        """Attack a batch by steps toward one class per image; see `Attack.toward`."""
        attack = partial(super().toward, generator=generator)
        drawn = shot
        if problem is None:
            drawn = drawn_shot(as_scenes(self.scene), images, shot, generator)
        if not isinstance(drawn, MixedShot):
            return attack(images, labels, classes, shot=drawn, problem=problem)
        goals = check_goals(images, labels, classes)
        return single(as_one(drawn, by_scene(drawn, images, goals, attack), self.noise_at))

    def last(
        self,
        images: Tensor,
        labels: Tensor,
        *,
        shot: Shot | MixedShot | None = None,
        generator: torch.Generator | None = None,
    ) -> Tensor:
        """Return the images after the last step; see `Attack.last`."""
        attack = partial(super().last, generator=generator)
        drawn = drawn_shot(as_scenes(self.scene), images, shot, generator)
        if not isinstance(drawn, MixedShot):
            return attack(images, labels, shot=drawn)
        goals = check_goals(images, labels, None)[:1]
        found = by_scene(drawn, images, goals, attack)
        return in_order([rows for rows, _ in found], [photos for _, photos in found])

    def problem(
        self, images: Tensor, shot: Shot | None, generator: torch.Generator | None
    ) -> Problem:
        if shot is None:
            size = (images.shape[-2], images.shape[-1])
            shot = self._scene_of(shot).sample(len(images), size, generator)
        with torch.no_grad():
            base = NOISE_AT[self.noise_at][0](images, shot)
        drawn = shot
        if moved_fields(shot.scene, self.optimise):
            # a shot that was drawn in inference mode takes no gradient
            drawn = shot._map(torch.clone).to(images.device)
        return self._drawn(images, drawn, base, generator)

    def _scene_of(self, shot: Shot | None) -> Scene:
        """Return the scene from which a shot, or fresh ones beside it, are drawn."""
        scene = as_scenes(self.scene)
        if isinstance(scene, Scene):
            return scene
        if shot is None:
            raise ValueError(
                "a mixture is attacked scene by scene: call the attack, or pass the shot of one."
            )
        return shot.scene

    def _drawn(
        self, images: Tensor, drawn: Shot, base: Tensor, generator: torch.Generator | None
    ) -> Problem:
        """Return the problem of a shot whose photos, or readings, are `base`."""
        before, after = NOISE_AT[self.noise_at]
        scene, size = self._scene_of(drawn), (images.shape[-2], images.shape[-1])
        fields = moved_fields(drawn.scene, self.optimise)
        several = self.eot > 1

        def render(noise: Tensor, pose: Tensor | None = None) -> Tensor:
            if pose is None:
                return after(base + noise, drawn).to(images.dtype)
            posed = aim(drawn, fields, pose)
            return after(before(images, posed) + noise, posed).to(images.dtype)

        def rehearse(noise: Tensor, pose: Tensor | None = None) -> Tensor:
            draws = scene.sample(self.eot * len(images), size, generator)
            if pose is not None:
                draws = aim(draws.to(images.device), fields, pose.repeat(self.eot, 1))
            fresh = before(images.repeat(self.eot, 1, 1, 1), draws)
            return after(fresh + noise.repeat(self.eot, 1, 1, 1), draws).to(images.dtype)

        def part(rows: Tensor) -> Problem:
            shot = drawn[rows.to(drawn.device)]
            return self._drawn(images[rows], shot, base[rows], generator)

        return Problem(
            render,
            rehearse if several else render,
            tuple(base.shape),
            images,
            part,
            views=self.eot,
            shot=drawn,
            base=None if several or fields else base,
            felt=_felt(self.noise_at, drawn),
            pose=pose_of(drawn, fields) if fields else None,
            aim=(lambda pose: aim(drawn, fields, pose)) if fields else None,
            still=() if "noise" in self.optimise else ("noise",),
        )


def _felt(noise_at: str, shot: ShotRecord) -> tuple[float, float]:
    """Return the values beyond which noise changes nothing: a finished photo's ends, or a full
    well. A reading below 0 still counts, since demosaicing mixes it with others."""
    if noise_at == "photo":
        return 0.0, 1.0
    return -math.inf, 1.0 if "saturate" in shot.plan else math.inf
