"""How well scores tell screens from other photos, with 95 % intervals, and what is mistaken."""

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from PIL import Image
from scipy.stats import rankdata

from moireaug.common.files import shown
from moireaug.evaluation.statistics import wilson
from training.report.plots import png

BOOTSTRAPS = 1000
THUMBNAIL, COLUMNS, MISTAKES = 160, 8, 16  # pixels; of a sheet's rows; of each kind


def auc(screens: np.ndarray, others: np.ndarray) -> float:
    """Return the area under the ROC curve of scores: the share of pairs in order."""
    ranks = rankdata(np.concatenate((screens, others)))[: len(screens)]
    return float((ranks.mean() - (len(screens) + 1) / 2) / len(others))


def equal_error_rate(screens: np.ndarray, others: np.ndarray) -> float:
    """Return the error rate at the threshold where as many screens are missed as others called
    screens."""
    thresholds = np.sort(np.concatenate((screens, others)))
    missed = np.searchsorted(np.sort(screens), thresholds) / len(screens)
    alarms = share_from(others, thresholds)
    nearest = np.abs(missed - alarms).argmin()
    return float((missed[nearest] + alarms[nearest]) / 2)


def share_from(scores: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """Return the share of scores that are at least as high as each threshold."""
    return (len(scores) - np.searchsorted(np.sort(scores), thresholds)) / len(scores)


def found_at(screens: np.ndarray, others: np.ndarray, false_alarms: float) -> int:
    """Return how many screens score above all but a share of the others."""
    allowed = min(int(false_alarms * len(others)), len(others) - 1)
    return int((screens > np.sort(others)[-1 - allowed]).sum())


def threshold_at(false_alarms: float, others: Sequence[np.ndarray]) -> float:
    """Return the threshold that a share of photos without screens exceeds.

    Args:
        others: scores of such photos by source, which weigh the same.
    """
    scores = np.concatenate(others)
    weights = np.concatenate([np.full(len(part), 1 / len(part)) for part in others])
    order = np.argsort(scores)
    below = np.cumsum(weights[order]) - weights[order]
    shares = below / (below[-1] or 1.0)  # one score alone is every threshold
    return float(np.interp(1 - false_alarms, shares, scores[order]))


def measures(screens: np.ndarray, others: np.ndarray, threshold: float | None) -> dict[str, Any]:
    """Return a collection's figures. At a threshold, APCER is the share of screens (attacks) that
    pass, BPCER that of other (bona fide) photos that do not."""
    rng = np.random.default_rng(0)
    draws = []
    for _ in range(BOOTSTRAPS):
        resampled = (rng.choice(scores, len(scores)) for scores in (screens, others))
        draws.append(auc(*resampled))
    found = found_at(screens, others, 0.1)
    figures = {
        "screens": len(screens),
        "others": len(others),
        "auc": auc(screens, others),
        "auc_interval": np.quantile(draws, (0.025, 0.975)).tolist(),
        "eer": equal_error_rate(screens, others),
        "found_at_10": found / len(screens),
        "found_at_10_interval": wilson(found, len(screens)),
    }
    if threshold is None:
        return figures
    passed, refused = int((screens <= threshold).sum()), int((others > threshold).sum())
    return figures | {
        "apcer": passed / len(screens),
        "apcer_interval": wilson(passed, len(screens)),
        "bpcer": refused / len(others),
        "bpcer_interval": wilson(refused, len(others)),
    }


def line_of(name: str, row: dict[str, Any]) -> str:
    """Return a collection's figures as a line."""
    parts = [f"{name}: {row['screens']} screens, {row['others']} others, AUC {row['auc']:.2f}"]
    parts[0] += " ({:.2f} to {:.2f})".format(*row["auc_interval"])
    parts.append(f"EER {row['eer']:.2f}")
    for key, label in (("found_at_10", "found at 10 %"), ("apcer", "APCER"), ("bpcer", "BPCER")):
        if key in row:
            low, high = row[f"{key}_interval"]
            parts.append(f"{label} {row[key]:.2f} ({low:.2f} to {high:.2f})")
    return ", ".join(parts)


def roc_plot(scores: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> bytes:
    """Return a PNG of the ROC curve of each collection: scores of screens, and of others."""
    figure = Figure(figsize=(5, 4), dpi=130, layout="constrained")
    axes = figure.subplots()
    axes.set(xlabel="false alarms", ylabel="screens found", xlim=(0, 1), ylim=(0, 1.01))
    lines, labels = [], []
    for name, (screens, others) in scores.items():
        thresholds = np.sort(np.concatenate((screens, others, [np.inf])))[::-1]
        rates = share_from(others, thresholds), share_from(screens, thresholds)
        lines += axes.step(*rates, where="post")
        labels.append(f"{shown(name)}, {auc(screens, others):.2f}")
    # given, as names that begin with _ are left out else
    legend = axes.legend(lines, labels, loc="lower right", fontsize="small")
    for text in legend.get_texts():
        text.set_parse_math(False)  # a folder may have dollar signs in its name
    return png(figure)


def sheet(rows: Sequence[Sequence[Image.Image]]) -> bytes:
    """Return a PNG of small pictures, each row of pictures beginning a new line."""
    lines = [row[i : i + COLUMNS] for row in rows for i in range(0, len(row), COLUMNS)]
    canvas = Image.new("RGB", (COLUMNS * THUMBNAIL, max(1, len(lines)) * THUMBNAIL), "white")
    for y, line in enumerate(lines):
        for x, picture in enumerate(line):
            small = picture.copy()
            small.thumbnail((THUMBNAIL - 4, THUMBNAIL - 4))
            canvas.paste(small, (x * THUMBNAIL, y * THUMBNAIL))
    file = io.BytesIO()
    canvas.save(file, "PNG")
    return file.getvalue()
