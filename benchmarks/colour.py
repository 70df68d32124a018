"""CIEDE2000, the difference of two colours as the eye sees it; about 1 is just noticeable."""

from __future__ import annotations

import math

import torch
from kornia.color import rgb_to_lab
from torch import Tensor


def visible_difference(first: Tensor, second: Tensor) -> Tensor:
    """CIEDE2000 of two photos (B, 3, H, W) of sRGB codes in [0, 1]: (B, H, W)."""
    return ciede2000(rgb_to_lab(first), rgb_to_lab(second))


def ciede2000(first: Tensor, second: Tensor) -> Tensor:
    """CIEDE2000 of two CIELAB colours, (N, 3, *) each, with the weights k_L = k_C = k_H = 1:
    (N, *).

    Sharma, Wu and Dalal (2005), "The CIEDE2000 color-difference formula: implementation notes,
    supplementary test data, and mathematical observations", equations 2 to 22. Symmetrical. Angles
    are in radians.
    """
    (l1, a1, b1), (l2, a2, b2) = first.unbind(1), second.unbind(1)
    chroma = (torch.hypot(a1, b1) + torch.hypot(a2, b2)) / 2
    g = (1 - _saturating(chroma)) / 2
    a1, a2 = (1 + g) * a1, (1 + g) * a2
    c1, c2 = torch.hypot(a1, b1), torch.hypot(a2, b2)
    h1, h2 = torch.atan2(b1, a1) % (2 * math.pi), torch.atan2(b2, a2) % (2 * math.pi)

    grey = c1 * c2 == 0  # a colour without chroma has no hue
    turn = h2 - h1
    far = turn.abs() > math.pi  # the shorter arc passes through 0
    turn = torch.where(grey, 0.0, turn - torch.where(far, 2 * math.pi * turn.sign(), 0.0))
    dl, dc, dh = l2 - l1, c2 - c1, 2 * (c1 * c2).sqrt() * torch.sin(turn / 2)

    l, c = (l1 + l2) / 2, (c1 + c2) / 2
    h = torch.where(grey, h1 + h2, (h1 + h2) / 2 + torch.where(far, math.pi, 0.0))
    t = (
        1
        - 0.17 * torch.cos(h - math.radians(30))
        + 0.24 * torch.cos(2 * h)
        + 0.32 * torch.cos(3 * h + math.radians(6))
        - 0.20 * torch.cos(4 * h - math.radians(63))
    )
    s_l = 1 + 0.015 * (l - 50).square() / (20 + (l - 50).square()).sqrt()
    s_c, s_h = 1 + 0.045 * c, 1 + 0.015 * c * t
    degrees = torch.rad2deg(h) % 360
    blue = torch.deg2rad(60 * torch.exp(-((degrees - 275) / 25).square()))
    r_t = -2 * _saturating(c) * torch.sin(blue)
    l, c, h = dl / s_l, dc / s_c, dh / s_h
    return (l.square() + c.square() + h.square() + r_t * c * h).clamp(min=0).sqrt()


def _saturating(chroma: Tensor) -> Tensor:
    """From 0 for greys to 1 for vivid colours."""
    return (chroma**7 / (chroma**7 + 25.0**7)).sqrt()
