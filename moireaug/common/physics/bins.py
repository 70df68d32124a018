"""The bins of a binned reading; see `moireaug.camera.exposure.bin_geometry`."""


def image_pixel_sides(xu, xv, yu, yv, scale):
    """Return u and v of the two sides of an image pixel, in sensor pixels.

    Args:
        xu, xv, yu, yv: panel pixels per sensor pixel. scale: panel pixels along a side.
    """
    by = scale / (xu * yv - xv * yu)
    return (by * yv, -by * yu), (-by * xv, by * xu)
