"""Progress bars, where there is somebody to see them."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any

from moireaug.common.extras import require

require("eval", "moireaug.common.progress")

from tqdm import tqdm  # noqa: E402  # a missing extra is named before it is imported


def progress_bar(items: Iterable[Any] | None = None, *, enabled: bool, **settings: Any) -> tqdm:
    """Return tqdm's bar of some items, or of a total among its settings; none is shown where it is
    not enabled or there is no standard error, as in a daemon or a program without a console."""
    return tqdm(items, disable=not enabled or sys.stderr is None, **settings)
