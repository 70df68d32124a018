"""Find a known picture in a photo of the screen that shows it, and bring the photo to its frame."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Grey = NDArray[Any]  # of uint8
Matrix = NDArray[Any]  # of float64

LONGEST = 1600  # pixels of a side at which features are looked for
REFINED = 800  # and at which the pose is refined
SOFTEN = 1.0  # sigma before features, which the moiré and the panel's own pixels would swamp
RATIO = 0.75  # of the distances of the best match and the next (Lowe, 2004)
REPROJECTION = 4.0  # pixels at LONGEST
FEWEST = 16  # matches that agree
ITERATIONS, ENOUGH = 60, 1e-6
SMOOTHED = 5  # pixels, of the Gaussian with which ECC compares
ALIKE = 0.5  # least correlation of the picture and the photo brought to its frame


class Registered(NamedTuple):
    """A photo's pose.

    Args:
        matrix: (3, 3), the homography from the picture's coordinates to the photo's, pixel centres
            at half integers.
        matches: features that agree on it.
        correlation: of the picture and the photo in its frame (ECC), 1 where they agree up to
            brightness and contrast.
    """

    matrix: Matrix
    matches: int
    correlation: float


def register(photo: Tensor, picture: Tensor, name: str = "the photo") -> tuple[Tensor, Tensor]:
    """Bring a photo to the frame of the picture that its screen shows.

    Args:
        photo, picture: (3, H, W) uint8, of any sizes.
        name: of the photo, for the message.

    Returns:
        The photo in the picture's frame and the picture, both cropped to the largest part that the
        photo shows in full, with the picture's proportions and about its visible middle: (3, h, w)
        uint8.

    Raises:
        TypeError: what is not (3, H, W) uint8.
        ValueError: the picture was not found in the photo, or could not be aligned.
    """
    for what, given in ((name, photo), ("the picture", picture)):
        if not isinstance(given, Tensor):
            raise TypeError(
                f"{what} must be a tensor (3, H, W) uint8; got a {type(given).__name__}. Convert "
                "an array (H, W, 3) with torch.from_numpy(array).permute(2, 0, 1)."
            )
        if given.dtype != torch.uint8 or given.ndim != 3 or len(given) != 3:
            raise TypeError(
                f"{what} must be (3, H, W) uint8; got {tuple(given.shape)} {given.dtype}. Convert "
                "values in [0, 1] with (255 * values).round().to(torch.uint8)."
            )
    found = find_pose(photo, picture, name)
    height, width = picture.shape[1:]
    rows, columns = _visible(found.matrix, (height, width), tuple(photo.shape[1:]))
    warped = _warp(_interleaved(photo), found.matrix, (height, width))
    aligned = torch.from_numpy(warped).permute(2, 0, 1)
    return aligned[:, rows, columns], picture[:, rows, columns]


def find_pose(photo: Tensor, picture: Tensor, name: str = "the photo") -> Registered:
    """Return the homography from a picture to a photo of it: SIFT features (Lowe, 2004) and a
    robust homography (MAGSAC++), refined by the correlation of all pixels (ECC: Evangelidis and
    Psarakis, 2008).

    Raises:
        ValueError: too few features agree, they fold the picture, or the refined photo does not
            look like the picture.
    """
    theirs, ours = (cv2.cvtColor(_interleaved(p), cv2.COLOR_RGB2GRAY) for p in (photo, picture))
    matrix, matches = _by_features(ours, theirs)
    if matrix is None or matches < FEWEST or _folds(matrix, ours.shape):
        raise ValueError(
            f"the picture was not found in {name}: {matches} features agree on where it is, and "
            f"{FEWEST} must. The photo must show most of the picture, sharp enough, and not "
            "mirrored; a picture of large flat areas cannot be found."
        )
    matrix, correlation = _refined(matrix, ours, theirs)
    if correlation < ALIKE:
        raise ValueError(
            f"{name} could not be aligned with the picture: their correlation is {correlation:.2f} "
            f"and must be at least {ALIKE}. Is it a photo of this picture, on a flat screen?"
        )
    return Registered(matrix, matches, correlation)


def _interleaved(picture: Tensor) -> Grey:
    return np.ascontiguousarray(picture.permute(1, 2, 0).numpy())


def _smaller(grey: Grey, longest: int) -> tuple[Grey, Matrix]:
    """Return a picture of at most so many pixels a side, and the matrix to its coordinates."""
    scale = min(1.0, longest / max(grey.shape))
    if scale == 1:
        return grey, np.eye(3)
    size = (round(grey.shape[1] * scale), round(grey.shape[0] * scale))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    return small, np.diag([size[0] / grey.shape[1], size[1] / grey.shape[0], 1.0])


def _by_features(ours: Grey, theirs: Grey) -> tuple[Matrix | None, int]:
    """Return the homography from our picture to theirs, and how many features agree on it."""
    sift = cv2.SIFT.create(nfeatures=6000)
    points, described, to_small = [], [], []
    for grey in (ours, theirs):
        small, matrix = _smaller(grey, LONGEST)
        key, description = sift.detectAndCompute(cv2.GaussianBlur(small, (0, 0), SOFTEN), None)
        points.append(
            np.array([k.pt for k in key], np.float32) + 0.5
        )  # OpenCV's centres are whole numbers
        described.append(description)
        to_small.append(matrix)
    if any(description is None or len(description) < FEWEST for description in described):
        return None, 0
    pairs = cv2.BFMatcher().knnMatch(described[0], described[1], k=2)
    good = [first for first, second in pairs if first.distance < RATIO * second.distance]
    if len(good) < FEWEST:
        return None, len(good)
    source = points[0][[match.queryIdx for match in good]]
    target = points[1][[match.trainIdx for match in good]]
    cv2.setRNGSeed(0)
    matrix, agree = cv2.findHomography(source, target, cv2.USAC_MAGSAC, REPROJECTION)
    if matrix is None:
        return None, 0
    return np.linalg.inv(to_small[1]) @ matrix @ to_small[0], int(agree.sum())


def _folds(matrix: Matrix, shape: tuple[int, ...]) -> bool:
    """Return whether a homography mirrors the picture, or its corners are not convex."""
    corners = _corners(matrix, shape[0], shape[1])
    turns = []
    for i in range(4):
        before, at, after = corners[i - 1], corners[i], corners[(i + 1) % 4]
        one, two = at - before, after - at
        turns.append(float(one[0] * two[1] - one[1] * two[0]))
    return min(turns) <= 0


def _corners(matrix: Matrix, height: float, width: float) -> Matrix:
    corners = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]], float)
    mapped = corners @ matrix.T
    return mapped[:, :2] / mapped[:, 2:]


def _refined(matrix: Matrix, ours: Grey, theirs: Grey) -> tuple[Matrix, float]:
    """Return the homography that makes the two most alike, and their correlation."""
    small, shrink = _smaller(ours, REFINED)
    # the photo as large as the picture: what is finer is moiré and the panel's own pixels
    longest = round(max(small.shape) * _magnification(matrix, ours, theirs))
    there, shrink_there = _smaller(theirs, longest)
    index = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])  # to OpenCV's coordinates
    first = index @ shrink_there @ matrix @ np.linalg.inv(index @ shrink)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, ITERATIONS, ENOUGH)
    start = (first / first[2, 2]).astype(np.float32)
    inside = _inside(first, small.shape, there.shape)
    try:
        alike, found = cv2.findTransformECC(
            small, there, start, cv2.MOTION_HOMOGRAPHY, criteria, inside, SMOOTHED
        )
    except cv2.error:  # it does not converge
        return matrix, 0.0
    back = np.linalg.inv(index @ shrink_there) @ found.astype(np.float64) @ index @ shrink
    return back / back[2, 2], float(alike)


def _inside(matrix: Matrix, picture: tuple[int, ...], photo: tuple[int, ...]) -> Grey:
    """Return a mask of where the photo shows the picture, away from its borders: smoothed by ECC,
    what surrounds the screen would pull at them."""
    corners = _corners(matrix, picture[0], picture[1])
    mask = np.zeros(photo[:2], np.uint8)
    cv2.fillConvexPoly(mask, corners.round().astype(np.int32), 255)
    margin = 2 * SMOOTHED + 1
    border = cv2.BORDER_CONSTANT
    return cv2.erode(mask, np.ones((margin, margin), np.uint8), borderType=border, borderValue=255)


def _magnification(matrix: Matrix, ours: Grey, theirs: Grey) -> float:
    """Return the longest side of the photo in units of the picture's, as it is shown there."""
    corners = _corners(matrix, ours.shape[0], ours.shape[1])
    area = cv2.contourArea(corners.astype(np.float32))
    return max(theirs.shape) / max(ours.shape) / (area / (ours.shape[0] * ours.shape[1])) ** 0.5


def _warp(photo: Grey, matrix: Matrix, size: tuple[int, int]) -> Grey:
    """Return the photo in the picture's frame of `size` (height, width), black off the photo."""
    corners = _corners(matrix, *size)
    larger = (cv2.contourArea(corners.astype(np.float32)) / (size[0] * size[1])) ** 0.5
    if larger > 1:  # a pixel of the picture is several of the photo: their mean
        photo = cv2.GaussianBlur(photo, (0, 0), 0.5 * (larger**2 - 1) ** 0.5)
    index = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])
    to_photo = index @ matrix @ np.linalg.inv(index)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpPerspective(photo, to_photo, (size[1], size[0]), flags=flags)


def _visible(matrix: Matrix, size: tuple[int, int], photo: tuple[int, ...]) -> tuple[slice, slice]:
    """Return rows and columns of the largest part of the picture, of its proportions and about its
    visible middle, that lies in the photo."""
    height, width = size
    x, y = np.meshgrid(np.linspace(0.5, width - 0.5, 65), np.linspace(0.5, height - 0.5, 65))
    inside = _is_in(photo, matrix, x, y)
    if inside.all():
        return slice(0, height), slice(0, width)
    middle_x, middle_y = x[inside].mean(), y[inside].mean()
    best = (slice(0, 0), slice(0, 0))
    for share in np.linspace(0.02, 1, 99):
        low_x, high_x = middle_x - share * width / 2, middle_x + share * width / 2
        low_y, high_y = middle_y - share * height / 2, middle_y + share * height / 2
        if low_x < 0 or low_y < 0 or high_x > width or high_y > height:
            break
        corners = np.meshgrid([low_x, high_x], [low_y, high_y])  # what is visible is convex
        if not _is_in(photo, matrix, *corners).all():
            break
        rows = slice(math.ceil(low_y), math.floor(high_y))
        best = (rows, slice(math.ceil(low_x), math.floor(high_x)))
    return best


def _is_in(photo: tuple[int, ...], matrix: Matrix, x: Matrix, y: Matrix) -> NDArray[np.bool_]:
    """Return which points of the picture lie in the photo, a pixel or more from its edges."""
    mapped = np.stack([x, y, np.ones_like(x)], -1) @ matrix.T
    at = mapped[..., :2] / mapped[..., 2:]
    return ((at >= 1) & (at <= np.array([photo[1] - 1, photo[0] - 1]))).all(-1)
