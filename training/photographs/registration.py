"""Find a known picture in a photo of the screen that shows it, and bring the photo to its frame."""

import math
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Grey = NDArray[Any]  # (H, W) uint8
Picture = NDArray[Any]  # (H, W, 3) uint8
Matrix = NDArray[Any]  # of float64

FEATURE_SIDE = 1600  # longest side in pixels of the pictures that features are found in
REFINEMENT_SIDE = 800  # longest side in pixels of the picture that the pose is refined with
FEATURE_SIGMA = 1.0  # of the blur before features, which moiré and panel pixels would swamp
MAX_DISTANCE_RATIO = 0.75  # of the distances of the best match and the next (Lowe, 2004)
MAX_REPROJECTION_ERROR = 4.0  # pixels at FEATURE_SIDE
MIN_MATCHES = 16  # that agree on the homography
ECC_ITERATIONS, ECC_TOLERANCE = 60, 1e-6
ECC_SMOOTHING = 5  # pixels, of the Gaussian before ECC
MIN_CORRELATION = 0.5  # of the picture and the photo in its frame
TO_OPENCV = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])  # whose pixel centres are whole


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
        ValueError: the picture was not found in the photo, could not be aligned, or is hardly in
            view.
    """
    matrix = find_pose(photo, picture, name)
    height, width = picture.shape[1:]
    rows, columns = _visible(matrix, (height, width), tuple(photo.shape[1:]))
    visible_picture = picture[:, rows, columns]
    if not visible_picture.numel():
        raise ValueError(f"{name} shows too little of the picture: it must show most of it.")
    warped = _warp(_interleaved(photo), matrix, (height, width))
    aligned = torch.from_numpy(warped).permute(2, 0, 1)
    return aligned[:, rows, columns], visible_picture


def find_pose(photo: Tensor, picture: Tensor, name: str = "the photo") -> Matrix:
    """Return the (3, 3) homography from a picture's coordinates to those of a photo of it, pixel
    centres at half integers: SIFT features (Lowe, 2004) and a robust homography (MAGSAC++), refined
    by the correlation of all pixels (ECC: Evangelidis and Psarakis, 2008).

    Raises:
        ValueError: too few features agree, they fold the picture, or the refined photo does not
            look like the picture.
    """
    greys = [cv2.cvtColor(_interleaved(p), cv2.COLOR_RGB2GRAY) for p in (photo, picture)]
    grey_photo, grey_picture = greys
    matrix, matches = _by_features(grey_picture, grey_photo)
    if matrix is None or matches < MIN_MATCHES or _is_folded(matrix, grey_picture.shape):
        raise ValueError(
            f"the picture was not found in {name}: {matches} features agree on where it is, and "
            f"{MIN_MATCHES} must. The photo must show most of the picture, sharp enough, and not "
            "mirrored; a picture of large flat areas cannot be found."
        )
    matrix, correlation = _refine(matrix, grey_picture, grey_photo)
    if correlation < MIN_CORRELATION:
        raise ValueError(
            f"{name} could not be aligned with the picture: their correlation is {correlation:.2f} "
            f"and must be at least {MIN_CORRELATION}. Is it a photo of this picture, on a flat "
            "screen?"
        )
    return matrix


def _interleaved(picture: Tensor) -> Picture:
    return np.ascontiguousarray(picture.permute(1, 2, 0).numpy())


def _shrink(grey: Grey, longest: int) -> tuple[Grey, Matrix]:
    """Return a picture shrunk to a longest side, and the matrix to its coordinates."""
    scale = min(1.0, longest / max(grey.shape))
    if scale == 1:
        return grey, np.eye(3)
    size = (round(grey.shape[1] * scale), round(grey.shape[0] * scale))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    return small, np.diag([size[0] / grey.shape[1], size[1] / grey.shape[0], 1.0])


def _by_features(picture: Grey, photo: Grey) -> tuple[Matrix | None, int]:
    """Return the homography from picture to photo, and the number of features that agree on it."""
    sift = cv2.SIFT.create(nfeatures=6000)
    points, descriptions, to_small = [], [], []
    for grey in (picture, photo):
        small, matrix = _shrink(grey, FEATURE_SIDE)
        blurred = cv2.GaussianBlur(small, (0, 0), FEATURE_SIGMA)
        key, description = sift.detectAndCompute(blurred, None)
        # OpenCV's centres are whole numbers
        points.append(np.array([k.pt for k in key], np.float32) + 0.5)
        descriptions.append(description)
        to_small.append(matrix)
    if any(description is None or len(description) < MIN_MATCHES for description in descriptions):
        return None, 0
    pairs = cv2.BFMatcher().knnMatch(descriptions[0], descriptions[1], k=2)
    ratio = MAX_DISTANCE_RATIO
    matches = [first for first, second in pairs if first.distance < ratio * second.distance]
    if len(matches) < MIN_MATCHES:
        return None, len(matches)
    source = points[0][[match.queryIdx for match in matches]]
    target = points[1][[match.trainIdx for match in matches]]
    cv2.setRNGSeed(0)
    matrix, is_inlier = cv2.findHomography(source, target, cv2.USAC_MAGSAC, MAX_REPROJECTION_ERROR)
    if matrix is None:
        return None, 0
    return np.linalg.inv(to_small[1]) @ matrix @ to_small[0], int(is_inlier.sum())


def _is_folded(matrix: Matrix, shape: tuple[int, ...]) -> bool:
    """Return whether a homography mirrors the picture, or its corners are not convex."""
    corners = _corners(matrix, shape[0], shape[1]).astype(np.float32)
    return cv2.contourArea(corners, oriented=True) <= 0 or not cv2.isContourConvex(corners)


def _corners(matrix: Matrix, height: float, width: float) -> Matrix:
    corners = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]], float)
    mapped = corners @ matrix.T
    return mapped[:, :2] / mapped[:, 2:]


def _refine(matrix: Matrix, picture: Grey, photo: Grey) -> tuple[Matrix, float]:
    """Return the homography of greatest correlation, and the correlation."""
    small, shrink = _shrink(picture, REFINEMENT_SIDE)
    # the photo as large as the picture: finer detail is moiré and the panel's own pixels
    enlargement = _enlargement(matrix, picture.shape)
    longest = round(max(small.shape) * (max(photo.shape) / max(picture.shape) / enlargement))
    small_photo, shrink_photo = _shrink(photo, longest)
    first = TO_OPENCV @ shrink_photo @ matrix @ np.linalg.inv(TO_OPENCV @ shrink)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, ECC_ITERATIONS, ECC_TOLERANCE)
    start = (first / first[2, 2]).astype(np.float32)
    inside = _inside(first, small.shape, small_photo.shape)
    try:
        correlation, refined = cv2.findTransformECC(
            small, small_photo, start, cv2.MOTION_HOMOGRAPHY, criteria, inside, ECC_SMOOTHING
        )
    except cv2.error:  # it does not converge
        return matrix, 0.0
    from_photo = np.linalg.inv(TO_OPENCV @ shrink_photo)
    result = from_photo @ refined.astype(np.float64) @ TO_OPENCV @ shrink
    return result / result[2, 2], float(correlation)


def _inside(matrix: Matrix, picture: tuple[int, ...], photo: tuple[int, ...]) -> Grey:
    """Return a mask of where the photo shows the picture, away from its borders: smoothed by ECC,
    the screen's surroundings would pull at them."""
    corners = _corners(matrix, picture[0], picture[1])
    mask = np.zeros(photo[:2], np.uint8)
    cv2.fillConvexPoly(mask, corners.round().astype(np.int32), 255)
    margin = 2 * ECC_SMOOTHING + 1
    border = cv2.BORDER_CONSTANT
    return cv2.erode(mask, np.ones((margin, margin), np.uint8), borderType=border, borderValue=255)


def _enlargement(matrix: Matrix, size: tuple[int, ...]) -> float:
    """Return the photo pixels along a side of a pixel of a picture of `size` (height, width), on
    average."""
    height, width = size
    area = cv2.contourArea(_corners(matrix, height, width).astype(np.float32))
    return (area / (height * width)) ** 0.5


def _warp(photo: Picture, matrix: Matrix, size: tuple[int, int]) -> Picture:
    """Return the photo in the picture's frame of `size` (height, width), black off the photo."""
    enlargement = _enlargement(matrix, size)
    if enlargement > 1:  # a pixel of the picture is several of the photo: their mean
        photo = cv2.GaussianBlur(photo, (0, 0), 0.5 * (enlargement**2 - 1) ** 0.5)
    to_photo = TO_OPENCV @ matrix @ np.linalg.inv(TO_OPENCV)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpPerspective(photo, to_photo, (size[1], size[0]), flags=flags)


def _visible(matrix: Matrix, size: tuple[int, int], photo: tuple[int, ...]) -> tuple[slice, slice]:
    """Return rows and columns of the largest part of the picture, of its proportions and about its
    visible middle, that lies in the photo: none where that is less than a fiftieth of a side."""
    height, width = size
    x, y = np.meshgrid(np.linspace(0.5, width - 0.5, 65), np.linspace(0.5, height - 0.5, 65))
    inside = _is_in(photo, matrix, x, y)
    if inside.all():
        return slice(0, height), slice(0, width)
    best = (slice(0, 0), slice(0, 0))
    if not inside.any():
        return best
    middle_x, middle_y = x[inside].mean(), y[inside].mean()
    for share in np.linspace(0.02, 1, 99):
        low_x, high_x = middle_x - share * width / 2, middle_x + share * width / 2
        low_y, high_y = middle_y - share * height / 2, middle_y + share * height / 2
        if low_x < 0 or low_y < 0 or high_x > width or high_y > height:
            break
        corners = np.meshgrid([low_x, high_x], [low_y, high_y])  # the visible part is convex
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
