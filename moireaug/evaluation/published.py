"""What the paper prints: success rates on Inception-V3, 5000 ImageNet images that it classifies correctly.

Keys are (row, column) of the tables of `suites.py`. The paper's table 3 calls C&W an L-infinity and MI-FGSM an L2
attack; its text says the reverse, which is what both are.
"""

from __future__ import annotations

from collections.abc import Sequence

_ATTACKS = ("MA", "BIM", "PGD", "C&W", "MI-FGSM")


def _lines(lines: dict[str, Sequence[float]], columns: Sequence[str] = _ATTACKS) -> dict[tuple[str, str], float]:
    return {(row, c): v for row, values in lines.items() for c, v in zip(columns, values, strict=True)}


_NONE = (1.000, 0.989, 0.990, 0.762, 0.991)
_EPS = ("MA ε = 2", "MA ε = 4", "MA ε = 6", "MA ε = 8")

PUBLISHED: dict[str, dict[tuple[str, str], float]] = {
    "success": _lines(
        {
            "ε = 2": (0.122, 0.163, 1.000, 0.876),
            "ε = 4": (0.122, 0.163, 1.000, 0.970),
            "ε = 6": (0.122, 0.163, 1.000, 0.990),
            "ε = 8": (0.122, 0.163, 1.000, 0.995),
        },
        ("rotated", "rotated and dim", "untargeted MA", "targeted MA"),
    ),
    "mean_normalised": _lines({"as it is": (1.0, 1.0, 1.0, 1.0), "mean restored": (0.960, 0.987, 0.994, 0.998)}, _EPS),
    "jpeg": _lines(
        {
            "no defence": _NONE,
            "quality 20": (0.938, 0.286, 0.276, 0.205, 0.491),
            "quality 40": (0.949, 0.431, 0.379, 0.207, 0.776),
            "quality 60": (0.956, 0.606, 0.522, 0.226, 0.892),
            "quality 80": (0.9881, 0.853, 0.797, 0.354, 0.964),
        }
    ),
    "defences": _lines(
        {
            "no defence": _NONE,
            "pixel deflection": (0.988, 0.714, 0.661, 0.109, 0.931),
            "bit depth 4": (0.998, 0.930, 0.945, 0.062, 0.976),
            "bit depth 5": (1.000, 0.984, 0.984, 0.182, 0.988),
            "median 2 × 2": (0.848, 0.918, 0.890, 0.074, 0.962),
            "median 3 × 3": (0.880, 0.850, 0.796, 0.121, 0.945),
            "TVM": (0.985, 0.810, 0.812, 0.804, 0.820),
            "quilting": (0.978, 0.530, 0.522, 0.516, 0.557),
        }
    ),
    "transfer": _lines(
        {
            "the attacked model": _NONE,
            "resnet50": (0.967, 0.176, 0.166, 0.116, 0.254),
            "resnet34": (0.927, 0.202, 0.202, 0.133, 0.294),
            "densenet121": (0.959, 0.173, 0.167, 0.121, 0.247),
            "vgg16": (0.982, 0.233, 0.224, 0.170, 0.312),
            "vgg19": (0.973, 0.202, 0.201, 0.146, 0.298),
        }
    ),
    "noise_position": _lines(
        {"no defence": (1.000, 0.998), "JPEG 20": (0.938, 0.857), "JPEG 40": (0.949, 0.902)}, ("MA", "Moiré + BIM")
    ),
}
