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
from moireaug.attacks.mixed import drawn_shot, join_results, split_by_scene
from moireaug.attacks.pose import pose_of, searched_fields, shot_at_pose
from moireaug.attacks.problem import Problem, Result, single
from moireaug.capture import develop, expose
from moireaug.mixed_shot import MixedShot, in_order
from moireaug.mixtures import Mixture, as_scenes, scenes_of
from moireaug.numeric import clip
from moireaug.scene.fields import one_of
from moireaug.scenes import Scene, Shot
from moireaug.shot import ShotRecord

Stage = Callable[[Tensor, ShotRecord], Tensor]

# where noise is added: the stage before it, and the stage after
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

    If the adversary also moves the camera, every step exposes the screen again, and the Result's
    shot is the one at the best pose. As always with noise at "raw", `capture(images, result.shot,
    result.noise)` is its photo.

    Args:
        scene: a Scene, a preset's name or a dict, or a list of these, a mixture: each image is then
            photographed in one of them, and the images of each scene are attacked together, as a
            batch of their own. `Result` says how their results are joined.
        eot: shots per step; above 1, each step averages over that many fresh draws of the scene
            (expectation over transformation; of a mixture, of the image's own scene), and the
            result is judged on `shot` alone. 1 attacks `shot` itself.
        noise_at: a key of `NOISE_AT`: "raw", or "photo", on the finished photo, which is then
            clipped to [0, 1]: the paper's Moiré + BIM (appendix E).
        optimise: variables of the search: "noise", and parts of the scene ("panel", "view", "lens",
            "sensor", "develop"), whose ranges are all searched within the scene's bounds by the
            same steps, with sizes in units of half a range's width. The search starts at the drawn
            shot, a restart at a fresh draw. ("view",) searches for the worst pose without noise. A
            field that no effect of the plan reads keeps its value. All scenes of a mixture must
            allow it.
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
            searched_fields(one, self.optimise)
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
        batches = split_by_scene(drawn, images, *check_goals(images, labels, targets))
        results = [attack(b.images, b.labels, b.targets, shot=b.shot) for b in batches]
        return join_results(drawn, batches, results, self.noise_at)

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
        attack: Callable[..., Result] = partial(super().toward, generator=generator)
        drawn = shot
        if problem is None:
            drawn = drawn_shot(as_scenes(self.scene), images, shot, generator)
        if not isinstance(drawn, MixedShot):
            return attack(images, labels, classes, shot=drawn, problem=problem)
        batches = split_by_scene(drawn, images, *check_goals(images, labels, classes))
        results = [attack(b.images, b.labels, b.targets, shot=b.shot) for b in batches]
        return single(join_results(drawn, batches, results, self.noise_at))

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
        batches = split_by_scene(drawn, images, *check_goals(images, labels, None))
        photos = [attack(batch.images, batch.labels, shot=batch.shot) for batch in batches]
        return in_order([batch.rows for batch in batches], photos)

    def problem(
        self, images: Tensor, shot: Shot | None, generator: torch.Generator | None
    ) -> Problem:
        if shot is None:
            scene, size = as_scenes(self.scene), (images.shape[-2], images.shape[-1])
            if isinstance(scene, Mixture):
                raise ValueError(
                    "a mixture is attacked scene by scene: call the attack, or pass the shot of "
                    "one."
                )
            shot = scene.sample(len(images), size, generator)
        with torch.no_grad():
            base = NOISE_AT[self.noise_at][0](images, shot)
        drawn = shot
        if searched_fields(shot.scene, self.optimise):
            # a shot that was drawn in inference mode takes no gradient
            drawn = shot._map(torch.clone).to(images.device)
        return self._problem_of(images, drawn, base, generator)

    def _problem_of(
        self, images: Tensor, drawn: Shot, base: Tensor, generator: torch.Generator | None
    ) -> Problem:
        """Return the problem of a shot whose photos, or readings, are `base`."""
        before_noise, after_noise = NOISE_AT[self.noise_at]
        scene, size = drawn.scene, (images.shape[-2], images.shape[-1])
        fields = searched_fields(drawn.scene, self.optimise)
        averages_draws = self.eot > 1

        def render(noise: Tensor, pose: Tensor | None = None) -> Tensor:
            if pose is None:
                return after_noise(base + noise, drawn).to(images.dtype)
            posed = shot_at_pose(drawn, fields, pose)
            return after_noise(before_noise(images, posed) + noise, posed).to(images.dtype)

        def render_draws(noise: Tensor, pose: Tensor | None = None) -> Tensor:
            draws = scene.sample(self.eot * len(images), size, generator)
            if pose is not None:
                draws = shot_at_pose(draws.to(images.device), fields, pose.repeat(self.eot, 1))
            fresh_base = before_noise(images.repeat(self.eot, 1, 1, 1), draws)
            noise = noise.repeat(self.eot, 1, 1, 1)
            return after_noise(fresh_base + noise, draws).to(images.dtype)

        def subset(rows: Tensor) -> Problem:
            shot = drawn[rows.to(drawn.device)]
            return self._problem_of(images[rows], shot, base[rows], generator)

        return Problem(
            render,
            render_draws if averages_draws else render,
            tuple(base.shape),
            images,
            subset,
            views=self.eot,
            shot=drawn,
            base=None if averages_draws or fields else base,
            effective_range=_effective_range(self.noise_at, drawn),
            pose=pose_of(drawn, fields) if fields else None,
            shot_at=(lambda pose: shot_at_pose(drawn, fields, pose)) if fields else None,
            frozen=() if "noise" in self.optimise else ("noise",),
        )


def _effective_range(noise_at: str, shot: ShotRecord) -> tuple[float, float]:
    """Return the low and high value beyond which noise changes nothing: the ends of a finished
    photo, or a full well. A reading below 0 still counts, as demosaicing mixes it with others."""
    if noise_at == "photo":
        return 0.0, 1.0
    return -math.inf, 1.0 if "saturate" in shot.plan else math.inf
