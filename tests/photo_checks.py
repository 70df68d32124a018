"""Checks of photos that several tests make."""


def in_range(photo, image):
    finite = photo.shape == image.shape and bool(photo.isfinite().all())
    return finite and photo.min() >= 0 and photo.max() <= 1
