"""Pose and lens: where on the screen does a pixel of the photo look?

Convention: continuous coordinates, pixel centres at half integers, x right, y down. *Image* coordinates span
[0, W] x [0, H] on the picture that is shown, *photo* coordinates [0, W] x [0, H] on the photo. The homography maps
image to photo; the lens maps photo to ideal (pinhole) coordinates, so that exposing a photo needs no inverse of it.
Everything here is float64, differentiable in every field, and of shape (B,) for fields.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import torch
from torch import Tensor

NEWTON_STEPS = 8
MOST_NODES = 25
NEAR_HORIZON = 1e-3  # rays that see the screen more than a thousand times as far as its centre look past it


def _matrix(rows: list[list[Tensor | float]], like: Tensor) -> Tensor:
    return torch.stack([torch.stack([like.new_zeros(like.shape) + v for v in row], -1) for row in rows], -2)


def _rotation_columns(yaw: Tensor, pitch: Tensor, roll: Tensor) -> tuple[Tensor, ...]:
    """What a point (x, y) of the screen's plane becomes: x, y and depth as pairs of coefficients of x and y."""
    (sy, cy), (sp, cp), (sr, cr) = ((torch.sin(a), torch.cos(a)) for a in map(torch.deg2rad, (yaw, pitch, roll)))
    across = (cy * cr, cy * sr)
    down = (sp * sy * cr - cp * sr, sp * sy * sr + cp * cr)
    depth = (cp * sy * cr + sp * sr, cp * sy * sr - sp * cr)
    return *across, *down, *depth


def camera_pose(view: dict[str, Tensor], size: tuple[int, int], scale: float) -> Tensor:
    """Pinhole camera before zoom, fit and shift: homography (B, 3, 3) about the centres of image and photo."""
    xx, xy, yx, yy, zx, zy = _rotation_columns(view["yaw"], view["pitch"], view["roll"])
    diagonal = (size[0] ** 2 + size[1] ** 2) ** 0.5
    f = diagonal / 2 / torch.tan(torch.deg2rad(view["fov"]) / 2)
    return _matrix([[xx, xy, 0.0], [yx, yy, 0.0], [zx / f, zy / f, 1.0]], f)


def released_pose(view: dict[str, Tensor], size: tuple[int, int], scale: float) -> Tensor:
    """The homography of the paper's released code, M = A2 T RX RY RZ A1 in index coordinates of the sensor's raster.

    The focal length is d / (2 sin gamma), and d where sin gamma = 0, d being the raster's diagonal; a negative one is
    used as it is. There gamma turns clockwise and theta moves the lower edge away: gamma = -roll,
    theta = -pitch and phi = yaw.
    """
    theta, phi, gamma = (torch.deg2rad(a) for a in (-view["pitch"], view["yaw"], -view["roll"]))
    h, w = size[0] * scale, size[1] * scale
    one, zero = torch.ones_like(gamma), torch.zeros_like(gamma)
    sin_gamma = torch.sin(gamma)
    frontal = sin_gamma == 0
    f = torch.where(frontal, one, 0.5 / torch.where(frontal, one, sin_gamma)) * (h * h + w * w) ** 0.5

    def turn(angle: Tensor, a: int, b: int) -> Tensor:
        entries = [[one if i == j else zero for j in range(4)] for i in range(4)]
        entries[a][a] = entries[b][b] = torch.cos(angle)
        entries[a][b], entries[b][a] = -torch.sin(angle), torch.sin(angle)
        return _matrix(entries, gamma)

    a1 = _matrix([[1.0, 0.0, -w / 2], [0.0, 1.0, -h / 2], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]], gamma)
    t = _matrix([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, f], [0, 0, 0, 1.0]], gamma)
    a2 = _matrix([[f, 0, w / 2, 0], [0, f, h / 2, 0], [0, 0, 1.0, 0]], gamma)
    m = a2 @ t @ turn(theta, 1, 2) @ turn(phi, 0, 2) @ turn(gamma, 0, 1) @ a1
    # index coordinates of the raster are scale * (x - centre) + scale * centre - 1/2 in centred image coordinates
    to_index = _matrix([[scale, 0, w / 2 - 0.5], [0, scale, h / 2 - 0.5], [0, 0, 1.0]], gamma)
    to_index_inverse = _matrix(
        [[1 / scale, 0, (0.5 - w / 2) / scale], [0, 1 / scale, (0.5 - h / 2) / scale], [0, 0, 1.0]], gamma
    )
    m = to_index_inverse @ m @ to_index
    return m / m[:, 2:, 2:]  # depth positive in the centre, whatever the sign of the focal length


POSES: dict[str, Callable[[dict[str, Tensor], tuple[int, int], float], Tensor]] = {
    "camera": camera_pose,
    "released": released_pose,
}


def homography(
    view: dict[str, Tensor],
    k1: Tensor,
    k2: Tensor,
    size: tuple[int, int],
    scale: float,
    *,
    pose: str = "camera",
    fit: bool = True,
) -> Tensor:
    """Image to ideal photo coordinates, (B, 3, 3) float64.

    Args:
        view: the (B,) fields of `View` by name, angles in degrees.
        k1, k2: (B,) lens coefficients: a fitted picture stays in view after the distortion, too.
        size: height and width of image and photo.
        scale: sensor pixels per photo pixel; only the "released" pose reads it.
        pose: a key of `POSES`.
        fit: see `View`.
    """
    m = POSES[pose](view, size, scale)
    h, w = size
    if pose == "camera":
        zoom = view["zoom"] * (_fitting_zoom(m, k1, k2, size) if fit else 1.0)
        place = _matrix([[zoom, 0, view["shift_x"] * w], [0, zoom, view["shift_y"] * h], [0, 0, 1.0]], zoom)
        m = place @ m
    centre = m.new_tensor([[1, 0, w / 2], [0, 1, h / 2], [0, 0, 1]])
    return centre @ m @ torch.linalg.inv(centre)


def _fitting_zoom(m: Tensor, k1: Tensor, k2: Tensor, size: tuple[int, int]) -> Tensor:
    """The greatest magnification at which the picture's border still lies inside the photo, (B,)."""
    half = m.new_tensor([size[1] / 2, size[0] / 2])
    border = m.new_tensor(
        [[x, y] for x in (-1, -0.5, 0, 0.5, 1) for y in (-1, -0.5, 0, 0.5, 1) if max(x * x, y * y) == 1]
    )
    seen = apply_homography(m, (border * half).expand(m.shape[0], -1, -1))
    to_edge = 1 / (seen / half).abs().amax(-1)  # along the ray through each point, (B, 16)
    edge = seen * to_edge[..., None]
    return (to_edge * distortion(edge, k1, k2, size)).amin(-1)


def nodes(positions: Tensor) -> Tensor:
    """Fewer positions with the same ends, for what is smooth over a picture and interpolated between them, float64.

    One in eight and at most 25: what is interpolated between them moves a reading by less than 1e-4 RMS of full scale.
    """
    return (
        torch.linspace(0, 1, min(MOST_NODES, len(positions) // 8 + 2, len(positions))).to(
            device=positions.device, dtype=torch.float64
        )
        * (positions[-1] - positions[0])
        + positions[0]
    )


@functools.lru_cache(maxsize=64)
def _between(n: int, size: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Linear interpolation from n nodes to `size` positions with the same ends: (size, n)."""
    with torch.inference_mode(False):  # what is kept must serve gradients, too
        at = torch.linspace(0, n - 1, size, dtype=torch.float64)[:, None]
        return (1 - (at - torch.arange(n, dtype=torch.float64)).abs()).clamp(min=0).to(device, dtype)


def enlarge(t: Tensor, size: tuple[int, int]) -> Tensor:
    """(B, n, h, w) on `nodes` to the lattice (B, n, *size) that they are nodes of, bilinear; (B, n, 1, 1) as it is.

    As two matrix products: ten times as fast on CPU as `F.interpolate`.
    """
    if t.shape[-2:] == (1, 1):
        return t
    down, across = (_between(n, s, t.dtype, t.device) for n, s in zip(t.shape[-2:], size, strict=True))
    return down @ t @ across.mT


def apply_homography(m: Tensor, points: Tensor) -> Tensor:
    """(B, 3, 3) on points (B, N, 2). Points behind the camera land far away, never on the photo."""
    lifted = points @ m[:, :, :2].mT + m[:, None, :, 2]
    ahead = lifted[..., 2:] > 1e-9
    return torch.where(ahead, lifted[..., :2] / torch.where(ahead, lifted[..., 2:], 1.0), 1e9)


def distortion(points: Tensor, k1: Tensor, k2: Tensor, size: tuple[int, int]) -> Tensor:
    """The factor 1 + k1 r^2 + k2 r^4 at photo points (B, N, 2) measured from the centre, r = 1 in the corners."""
    r2 = points.square().sum(-1) * (4 / (size[0] ** 2 + size[1] ** 2))
    return 1 + r2 * (k1[:, None] + k2[:, None] * r2)


def undistortion(points: Tensor, k1: Tensor, k2: Tensor, size: tuple[int, int]) -> Tensor:
    """The factor (B, N) that takes ideal points (B, N, 2), measured from the photo's centre, to photo points: the
    inverse of the lens, by Newton steps.

    Beyond the photo's corners (r > 1), where the polynomial may fold, its tangent at r = 1 is followed instead.
    """
    half_diagonal = (size[0] ** 2 + size[1] ** 2) ** 0.5 / 2
    k1, k2 = k1[:, None], k2[:, None]
    ideal = points.norm(dim=-1) / half_diagonal
    slope = 1 + 3 * k1 + 5 * k2
    beyond = 1 + (ideal - 1 - k1 - k2) / slope

    def newton(r: Tensor) -> Tensor:
        r2 = r * r
        error = r * (1 + r2 * (k1 + k2 * r2)) - ideal
        return (r - error / (1 + r2 * (3 * k1 + 5 * k2 * r2)).clamp(min=0.05)).clamp(min=0, max=1)

    with torch.no_grad():
        r = ideal.clamp(min=0, max=1)
        for _ in range(NEWTON_STEPS):
            r = newton(r)
    r = torch.where(beyond > 1, beyond, newton(r))
    tiny = ideal < 1e-12
    return torch.where(tiny, 1.0, r / torch.where(tiny, 1.0, ideal))


def image_to_photo(points: Tensor, matrix: Tensor, size: tuple[int, int], lens: tuple[Tensor, Tensor] | None) -> Tensor:
    """Image coordinates (B, N, 2) to photo coordinates through homography (B, 3, 3) and lens. Differentiable."""
    seen = apply_homography(matrix, points)
    if lens is None:
        return seen
    centre = seen.new_tensor([size[1] / 2, size[0] / 2])
    return (seen - centre) * undistortion(seen - centre, *lens, size)[..., None] + centre


def look(
    matrix: Tensor,
    rows: Tensor,
    cols: Tensor,
    size: tuple[int, int],
    *,
    affine: bool,
    lens: tuple[Tensor, Tensor] | None,
    upright: bool = False,
) -> tuple[Tensor, Tensor]:
    """Where the lattice `rows` x `cols` lands: from photo to image when exposing, from image to photo when registering.

    Args:
        matrix: (B, 3, 3) homography, of depth 1 in the lattice's centre.
        rows, cols: (h,) or (B, h), and (w,) or (B, w), coordinates; they set the dtype of the result.
        size: height and width of photo and image.
        affine: the last row of `matrix` is (0, 0, 1).
        lens: (k1, k2), each (B,), to go through the lens before the homography, or None.
        upright: `matrix` is affine and turns nothing: rows stay rows and columns stay columns.

    Returns:
        x and y, each (B, h, w); upright and without a lens (B, 1, w) and (B, h, 1). Rays at and past the horizon land
        far outside of the picture.
    """
    h, w = size
    centre = matrix.new_tensor([[1, 0, w / 2], [0, 1, h / 2], [0, 0, 1]])
    # the constant terms are folded in float64, before the cast to the lattice's dtype
    m = (matrix @ centre)[:, : 2 if affine else 3].to(rows.dtype)[..., None, None]
    u, v = (cols - w / 2)[..., None, None, :], (rows - h / 2)[..., None, :, None]
    across, down, middle = m[:, :, 0] * u, m[:, :, 1] * v, m[:, :, 2]  # of x, y and, unless affine, depth
    if lens is None:
        if upright:
            return across[:, 0] + middle[:, 0], down[:, 1] + middle[:, 1]
        lifted = across + (down + middle)
    else:
        k1, k2 = (k.to(rows.dtype)[:, None, None, None] for k in lens)
        a, b = (t * t * (4 / (h * h + w * w)) for t in (u, v))  # the square of the radius is their sum
        bend = torch.addcmul((1 + a * (k1 + k2 * a)) + b * (k1 + k2 * b), 2 * k2 * a, b)
        lifted = torch.addcmul(middle, bend, across + down)
    if not affine:
        lifted = lifted[:, :2] * lifted[:, 2:].clamp(min=NEAR_HORIZON).reciprocal()
    return lifted.unbind(1)  # type: ignore[return-value]


def lattice(rows: Tensor, cols: Tensor) -> Tensor:
    """The points of `rows` x `cols`, x then y: (1, h, w, 2)."""
    return torch.stack(torch.broadcast_tensors(cols[None, :], rows[:, None]), -1)[None]


def jacobian(inverse: Tensor, points: Tensor, size: tuple[int, int], *, lens: tuple[Tensor, Tensor] | None) -> Tensor:
    """d(image x, y) / d(photo u, v) at photo points (B or 1, ..., 2): (B, ..., 2, 2), the last axis over u and v."""
    h, w = size
    lead = [1] * (points.ndim - 1)
    p = points - points.new_tensor([w / 2, h / 2])
    through_lens = torch.eye(2, dtype=p.dtype, device=p.device)
    if lens is not None:
        k1, k2 = (k.reshape(-1, *lead, 1) for k in lens)
        c = 4 / (h * h + w * w)
        r2 = c * p.square().sum(-1)[..., None, None]
        along = p[..., :, None] * p[..., None, :]
        through_lens = (1 + r2 * (k1 + k2 * r2)) * through_lens + 2 * c * (k1 + 2 * k2 * r2) * along
        p = p * (1 + r2 * (k1 + k2 * r2))[..., 0]
    centre = inverse.new_tensor([[1, 0, w / 2], [0, 1, h / 2], [0, 0, 1]])
    m = (inverse @ centre).reshape(-1, *lead[1:], 3, 3)
    lifted = (m[..., :2] @ p[..., None])[..., 0] + m[..., 2]
    d = lifted[..., 2:].clamp(min=1e-6)
    through_view = (m[..., :2, :2] - (lifted[..., :2] / d)[..., None] * m[..., 2:, :2]) / d[..., None]
    return through_view @ through_lens
