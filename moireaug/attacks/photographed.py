"""A camera in front of a model, for attacks of other libraries: the codes or the light of raw
readings, or images, to logits."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn

from moireaug.attacks.bounds import BOUNDS
from moireaug.attacks.model import watched_copy
from moireaug.camera.effects.srgb import codes_of_light, light_of_codes
from moireaug.capture import capture, develop, expose
from moireaug.common.argument_checks import check_callable, one_of
from moireaug.common.networks import rejects_of
from moireaug.scenes import Shot

# the camera from each place of the noise to the photo
CAMERAS: dict[str, Callable[[Tensor, Shot], Tensor]] = {"raw": develop, "image": capture}

# share of the way to another row's clean input by which a row may stray and still be matched
MAX_STRAY = 0.25
SAME_INPUT_ERROR = 1e-12  # mean squared difference of two inputs that are equal up to rounding


class Photographed(nn.Module):
    """Put a camera in front of a model: logits = model(develop(raw, shot)), where raw is given by
    its sRGB values, or model(capture(image, shot)).

    Through it, any attack on an `nn.Module` whose inputs lie in [0, 1] attacks the camera and the
    model together; start the attack from `clean`. Its L-infinity eps bounds sRGB values, as
    `MoireAttack`'s `bound="codes"`, within [0, 1].

    Many attacks drop rows of the batch or change their order. Each row is therefore matched to its
    shot by its values: to the nearest row of `clean` (mean square). It is refused if it has moved
    more than a quarter of the way towards another row, or is farther from its own than another row
    of `clean` is. An attack that strays that far, or starts from noise or a blank input, needs one
    image at a time, with which there is nothing to tell apart.

    Args:
        model: (B, 3, H, W) photos in [0, 1] to (B, K) logits; a module becomes a submodule, so that
            its mode and device are set here.
        images: (B, 3, H, W) float in [0, 1].
        shot: one draw for these images.
        noise_at: place of the attack, a key of `CAMERAS`: "raw", the raw images, or "image", the
            pictures that the screen shows.
        bound: scale of the inputs at "raw", and so of an attack's eps: "codes", sRGB, or "light",
            linear. The same in a scene without `Develop.linear_light`.

    Attributes:
        clean: the unattacked inputs: the raw images, of `shot.raw_shape()`, clipped to [0, 1], on
            that scale; or the images.

    Raises:
        TypeError, ValueError: a model that is not callable, images or a shot that `capture`
            refuses, or rows of the same input but different shots, which cannot be told apart.
    """

    clean: Tensor
    gaps: Tensor

    def __init__(
        self,
        model: nn.Module | Callable[[Tensor], Tensor],
        images: Tensor,
        shot: Shot,
        *,
        noise_at: str = "raw",
        bound: str = "codes",
    ) -> None:
        super().__init__()
        check_callable("Photographed's model", model)
        self.model, self.shot = model, shot
        self.rejects = rejects_of(model)
        self.noise_at = one_of("noise_at", noise_at, CAMERAS)
        one_of("bound", bound, BOUNDS)
        self.dtype = images.dtype if isinstance(images, Tensor) else None
        if isinstance(model, nn.Module):
            # an attack restores the mode that it finds here, and must not put an evaluated model
            # into training
            self.training = model.training
        with torch.no_grad():
            raw = expose(images, shot)  # at "image", for its checks alone
            is_light = noise_at == "raw" and shot.scene.develop.linear_light
            self.takes_codes_of_light = is_light and bound == "codes"
            clean = raw.clamp(0, 1) if noise_at == "raw" else images.detach().clone()
            clean = codes_of_light(clean) if self.takes_codes_of_light else clean
            gaps = _mean_squared_distances(clean, clean)
            _refuse_ambiguous_rows(clean, gaps, shot, noise_at)
        self.register_buffer("clean", clean, persistent=False)
        self.register_buffer("gaps", gaps, persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """Return the logits (b, K) of perturbed rows of `clean`, any of them in any order.
        Differentiable in x.

        Raises:
            ValueError: rows of another shape, or that cannot be told apart; from a backward pass, a
                model that brings no gradient to the photos.
        """
        return self.model(watched_copy(self.photos(x)))

    def photos(self, x: Tensor) -> Tensor:
        """Return the photos (b, 3, H, W) in [0, 1] of perturbed rows of `clean`, each by its own
        shot; gradient and errors as in a call."""
        rows = self.rows(x).to(self.shot.device)
        light = light_of_codes(x) if self.takes_codes_of_light else x
        return CAMERAS[self.noise_at](light, self.shot[rows]).to(self.dtype)

    @torch.no_grad()
    def rows(self, x: Tensor) -> Tensor:
        """Return which rows of `clean` these are, (b,) int64; errors as in a call. Costs b * B
        inner products in float64."""
        if x.ndim != 4 or x.shape[1:] != self.clean.shape[1:]:
            raise ValueError(
                f"rows must have the shape (b, {', '.join(map(str, self.clean.shape[1:]))}) of "
                f"Photographed.clean; got {tuple(x.shape)}."
            )
        if len(self.clean) == 1:
            return torch.zeros(len(x), dtype=torch.int64, device=x.device)
        distances = _mean_squared_distances(x, self.clean)
        distance, nearest = distances.min(1, keepdim=True)
        gaps, nearest = self.gaps[nearest[:, 0]].double(), nearest[:, 0]
        is_certain = (distances - distance > (1 - 2 * MAX_STRAY) * gaps) & (distance < gaps)
        is_ambiguous = (~is_certain & (gaps > SAME_INPUT_ERROR)).any(1)
        if is_ambiguous.any():
            row = int(is_ambiguous.nonzero()[0])
            raise ValueError(
                f"row {row} is too far from Photographed.clean, or not finite: row "
                f"{int(nearest[row])} is the nearest there, but its shot cannot be told for "
                "sure. Start the attack from Photographed.clean; if it goes that far, attack one "
                "image at a time: Photographed(model, images[i : i + 1], shot[i : i + 1])."
            )
        return nearest


def _mean_squared_distances(x: Tensor, clean: Tensor) -> Tensor:
    """Return the mean squared difference of each row (b, ...) from each other (B, ...), (b, B)
    float64."""
    x, clean = x.flatten(1).double(), clean.flatten(1).double()
    distances = torch.cdist(x, clean, compute_mode="use_mm_for_euclid_dist")
    return distances.square() / max(1, x.shape[1])


def _refuse_ambiguous_rows(clean: Tensor, gaps: Tensor, shot: Shot, noise_at: str) -> None:
    """Refuse rows of the same input whose shots differ. Where both make the same photo of any
    input, either will do."""
    equal_pairs = (gaps <= SAME_INPUT_ERROR).triu(1).nonzero().tolist()
    if not equal_pairs:
        return
    g = torch.Generator().manual_seed(0)
    inputs = torch.rand(clean[:1].shape, generator=g, dtype=torch.float32, device="cpu")
    photos = CAMERAS[noise_at](inputs.to(clean).expand_as(clean), shot)
    for i, j in equal_pairs:
        if not torch.allclose(photos[i], photos[j], rtol=0, atol=1e-4):
            raise ValueError(
                f"rows {i} and {j} have the same {noise_at} but different shots, and cannot be "
                "told apart: put them into two batches."
            )
