"""The Moiré Attack: noise on the raw reading of a photographed screen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import torch
from torch import Tensor

from moireaug.attacks.bounds import BOUNDS, Bound, bound_on_reading
from moireaug.attacks.camera import NOISE_AT, CameraProblem, searched_fields
from moireaug.attacks.loop import Attack
from moireaug.attacks.losses import attack_margin
from moireaug.attacks.search import Search
from moireaug.common.argument_checks import check_whole, one_of
from moireaug.mixtures import SceneLike, as_scenes, scenes_of
from moireaug.scene.mixed_shot import MixedShot
from moireaug.scene.shot_checks import check_batch
from moireaug.scenes import Shot


@dataclass(frozen=True, kw_only=True)
class MoireAttack(Attack):
    """The Moiré Attack (paper, section 3 and Algorithm 1): find delta on the camera's raw image so
    that the developed photo `develop(expose(x) + delta)` is misclassified, or classified as a
    target.

    The image is exposed once, and every step develops the same raw image plus the current delta;
    the best step per image is returned. The algorithm as printed is the rule "printed", whose noise
    exceeds eps: see `rules.Printed`.

    If the attacker also moves the camera, every step exposes the image again, and the Result has
    the shot at the best pose. With noise at "raw", `capture(images, result.shot, result.noise)` is
    the attacked photo.

    Args:
        scene: a Scene, a preset's name or a dict, or a list of these, a mixture: each image is then
            photographed in one of them, and the images of each scene are attacked together, as a
            batch of their own. `Result` says how their results are joined.
        bound: scale of eps. "codes", sRGB: each raw value stays within decode(encode(value) +-
            eps), an interval of its own. "light", linear: within value +- eps. They are the same in
            a scene without `Develop.linear_light`, and for noise at "photo".
        eot: photos per step; above 1, each step averages over that many fresh draws of the scene
            (expectation over transformation; of a mixture, of the image's own scene), and success
            is that on `shot` alone. 1 attacks `shot` itself.
        noise_at: a key of `NOISE_AT`: "raw", or "photo", on the finished photo, which is then
            clipped to [0, 1]: the paper's Moiré + BIM (appendix E).
        optimise: variables of the search: "noise", and parts of the scene ("panel", "view", "lens",
            "sensor", "develop"), whose ranges are all searched within the scene's bounds by the
            same steps, with sizes in units of half a range's width. The search starts at the drawn
            shot, a restart at a fresh draw. ("view",) searches for the worst pose without noise.
            Fields without an effect in this scene keep their values. All scenes of a mixture must
            allow it.
        draws: number of photos per image, of which the one that fools the model most without noise
            is attacked (worst of k: Engstrom et al., 2019). The first is `shot`; the others are
            drawn. `Result.clean_correct` is that of `shot`.
        shrink: images are crops, parts of larger photos with so many sensor pixels per image pixel;
            None leaves the scene as it is. See `Scene.with_shrink`.
        others: see `Attack`.

    Raises:
        TypeError, ValueError: settings of the wrong type, out of range or that exclude one another;
            an `optimise` that this scene, or the shot of a call, does not allow: an exposure
            without a gradient in the shot ("spectral", "box" and "mean" have one), a pose in whole
            degrees, no range. A model without an answer to any of a batch's images; in a mixture,
            to any of a scene's.
    """

    scene: SceneLike = "screen_photo"
    eot: int = 1
    noise_at: str = "raw"
    bound: str = "codes"
    optimise: tuple[str, ...] = ("noise",)
    draws: int = 1
    shrink: float | tuple[float, float] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        scene = as_scenes(self.scene, self.shrink)
        object.__setattr__(self, "scene", scene)
        check_whole("eot", self.eot, 1, noun="the shots per step")
        if self.until_fooled and self.eot > 1:
            raise ValueError(
                f"until_fooled asks whether one shot is fooled: it needs eot = 1; got {self.eot}."
            )
        one_of("noise_at", self.noise_at, NOISE_AT)
        one_of("bound", self.bound, BOUNDS)
        parts = self.optimise
        if not isinstance(parts, (tuple, list)) or not parts or len(set(parts)) < len(parts):
            raise ValueError(
                "optimise must be a tuple of different names, like ('noise', 'view'); got "
                f"{self.optimise!r}."
            )
        object.__setattr__(self, "optimise", tuple(self.optimise))
        for one in scenes_of(scene):
            searched_fields(one, self.optimise)
        check_whole("draws", self.draws, 1, noun="the shots of which the worst is attacked")
        if self.draws > 1 and self.eot > 1:
            raise ValueError(
                f"draws = {self.draws} attacks the worst of several shots, and eot = {self.eot} an "
                "unknown one: set one of them to 1."
            )
        if self.rule == "printed" and (self.eot > 1 or self.optimise != ("noise",)):
            raise ValueError(
                "the rule 'printed' adds to the reading of one shot: it needs eot = 1 and optimise "
                f"= ('noise',); got eot = {self.eot} and optimise = {self.optimise!r}. Use 'sign'."
            )

    def draw(
        self, images: Tensor, shot: Shot | MixedShot | None, generator: torch.Generator | None
    ) -> Shot | MixedShot:
        if shot is None:
            size = images.shape[-2], images.shape[-1]
            return as_scenes(self.scene).sample(len(images), size, generator)
        check_batch(images.shape, shot)
        return shot

    def problem(
        self, images: Tensor, shot: Shot, generator: torch.Generator | None
    ) -> CameraProblem:
        with torch.no_grad():
            clean = NOISE_AT[self.noise_at][0](images, shot)
        if searched_fields(shot.scene, self.optimise):
            # a shot that was drawn in inference mode takes no gradient
            shot = shot.map_rows(torch.clone).to(images.device)
        bound = Bound(self.eps, "codes")  # of a photo, whatever `self.bound` says of readings
        if self.noise_at == "raw":
            bound = bound_on_reading(self.eps, self.bound, shot.scene)
        return CameraProblem(
            images, shot, clean, bound, self.noise_at, self.optimise, self.eot, generator
        )

    def starting_at(self, search: Search) -> Search:
        return search if self.draws == 1 else _at_worst_draw(search, self.draws)


def _at_worst_draw(search: Search, draws: int) -> Search:
    """Return the search at each image's worst shot: that of the greatest margin without noise,
    among its own and `draws` - 1 others."""
    worst = problem = cast(CameraProblem, search.problem)
    photos, logits = search.images_and_logits(problem.clean_point())
    clean_correct = search.is_right(photos, logits)
    margins = attack_margin(logits, search.labels, search.targets)
    for _ in range(draws - 1):
        drawn = problem.drawn_again()
        _, logits = replace(search, problem=drawn).images_and_logits(drawn.clean_point())
        drawn_margins = attack_margin(logits, search.labels, search.targets)
        worst = worst.where(drawn_margins > margins, drawn)
        margins = torch.maximum(margins, drawn_margins)
    return replace(search, problem=worst, clean_correct=clean_correct)
