"""A panel of fewer pixels than the picture: each shows the mean under a triangle, along each axis,
which ends one panel pixel from its centre. `alpha` is panel pixels per picture pixel."""

from moireaug.common.physics.operations import absolute, ceil, maximum


def centre_on_picture(pixel, lead, alpha):
    """Return where a panel pixel's centre lies on the picture, which begins after `lead` of
    them."""
    return (pixel - lead + 0.5) / alpha


def first_under_triangle(centre, alpha):
    """Return the first picture pixel under the triangle around a centre."""
    return ceil(centre - 1 / alpha - 0.5)


def triangle_weight(pixel, centre, alpha):
    """Return how much a picture pixel weighs under the triangle, before weights sum to 1."""
    return maximum(1 - absolute(pixel + 0.5 - centre) * alpha, 0.0)
