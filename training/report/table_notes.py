"""What a report shows of a suite's table beside its figures: pictures, and values of its note."""

import re
from typing import Any

from moireaug.attacks import Patch
from moireaug.evaluation.attackers import PoseUnknownAttacker
from moireaug.evaluation.autoattack import QUERIES_PER_STEP
from moireaug.evaluation.classifiers import DEFENCE_DRAWS
from moireaug.evaluation.conditions import in_255ths
from moireaug.evaluation.tables import Cell, Table
from training.runs.metrics import SuiteMetrics

# of each table, the row/column of the cells whose pictures are shown, as a regular expression
PICTURES = {
    "ladder": "(clean|moire|ma_{eps})/.*",
    "full_ladder": "(clean|moire|ma_{eps})/.*",
    "standard": "{first_row}/.*",
    "worst_case": "{first_row}/.*",
    "success": "eps_{eps}/.*",
    "appearance": ".*",
    "jpeg": "undefended/.*",
    "demoireing": "undefended/(?!adaptive).*",
    "unseen": ".*/moire",
    "factors": ".*/moire",
    "budget": ".*/(ma|bim)",
    "shifts": ".*/unattacked",
    "threat": ".*, Pixel 4/angle_90|monitor, Sony/angle_.*",
}


def pictured_cells(table: Table, eps: float) -> list[Cell]:
    """Return the cells whose pictures are shown; a worst case has none.

    Args:
        eps: middle bound of the suite.
    """
    if table.name not in PICTURES:
        return []
    codes, first_row = re.escape(in_255ths(eps)), re.escape(table.rows[0])
    pattern = PICTURES[table.name].format(eps=codes, first_row=first_row)
    return [
        cell
        for cell in table.cells
        if not cell.worst and re.fullmatch(pattern, f"{cell.row}/{cell.column}")
    ]


def note_values(table: Table, metrics: SuiteMetrics) -> dict[str, Any]:
    """Return the values of the note below a table."""
    has_camera_attackers = table.name in ("standard", "adaptive")
    return {
        "area": Patch.area,
        "codes": in_255ths(metrics.eps),
        "draws": DEFENCE_DRAWS,
        "has_square": "square" in table.columns,
        "no_turning": has_camera_attackers and "turning" not in table.columns,
        "own": "" if metrics.scene_name.startswith("custom") else metrics.scene_name,
        "queries": QUERIES_PER_STEP * metrics.steps,
        "shots": PoseUnknownAttacker.shots,
        "steps": metrics.steps,
    }
