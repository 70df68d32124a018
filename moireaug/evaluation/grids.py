"""A suite's table in every form: tidy rows, CSV, Markdown, HTML, and the words that say what it shows."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

from moireaug.evaluation import tables
from moireaug.evaluation.published import PUBLISHED
from moireaug.evaluation.statistics import wilson
from moireaug.evaluation.sweep import Index, Row, gather
from moireaug.evaluation.table import Cell, Table
from moireaug.evaluation.words import Metrics, duration, percent

FIELDS = ("suite", "row", "column", "rung", "judge", "eps", "targeted", "success", "low", "high", "accuracy",
          "counted", "n", "undecided", "seconds", "paper", "psnr", "ssim", "ciede2000", "largest")  # fmt: skip
CONTROLS = ("clean", "rotated", "rotated and dim", "no moiré", "moiré, δ = 0", "random noise")
NOISELESS, RANDOM = "moiré, δ = 0", "random noise"


def tidy(table: Table, index: Index) -> list[Metrics]:
    """One plain dict a cell, with the keys of `FIELDS`; unknown ones are None."""
    out = []
    for (row, column), cell in table.cells.items():
        out.append(_pooled(cell, index) | {"suite": table.name, "row": row, "column": column})
        paper = PUBLISHED.get(table.name, {}).get((row, column)) if table.published else None
        out[-1] = {key: out[-1].get(key) for key in FIELDS} | {"paper": paper}
    return out


def _pooled(cell: Cell, index: Index) -> Metrics:
    rows = [gather(index, rung, cell.judge) for rung in cell.rungs]
    rows = [_worst(rows)] if cell.worst else rows
    hits, counted, n = (sum(f(r) for r in rows) for f in (lambda r: r.hits, lambda r: sum(r.counted), _shown))
    # photos of one image are no independent trials: the interval is that of so many images
    low, high = wilson(hits / len(rows), counted / len(rows))
    return {
        "rung": rows[0].name if len(rows) == 1 else f"{len(rows)} pooled",
        "judge": cell.judge.name,
        "eps": rows[0].eps,
        "targeted": rows[0].targeted,
        "success": hits / counted if counted else None,
        "low": low,
        "high": high,
        "accuracy": sum(sum(r.correct) for r in rows) / n if n else None,
        "counted": counted,
        "n": n,
        "undecided": sum(sum(r.undecided) for r in rows),
        "seconds": sum(r.seconds for r in rows),
        **rows[0].measured,
    }


def _worst(rows: Sequence[Row]) -> Row:
    """Each image at the worst of several rungs."""
    worst = Row("worst case", "worst case", max(r.eps for r in rows), False)  # its time is its rungs'
    worst.correct = [all(seen) for seen in zip(*(r.correct for r in rows), strict=True)]
    worst.fooled = [any(seen) for seen in zip(*(r.fooled for r in rows), strict=True)]
    worst.undecided = [any(seen) for seen in zip(*(r.undecided for r in rows), strict=True)]
    worst.counted = rows[0].counted
    return worst


def _shown(row: Row) -> int:
    return len(row.correct)


def to_csv(rows: Sequence[Metrics]) -> str:
    """All cells as comma-separated values, with a header."""
    file = io.StringIO()
    writer = csv.DictWriter(file, FIELDS, lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)
    return file.getvalue()


def _cell(rows: Sequence[Metrics], row: str, column: str) -> Metrics:
    return next((r for r in rows if r["row"] == row and r["column"] == column), {})


def _tail(rows: Sequence[Metrics], row: str) -> tuple[str, str]:
    """How many images a row counts, and the seconds that its cells took."""
    mine = [r for r in rows if r["row"] == row]
    counts = dict.fromkeys(r["counted"] for r in mine)
    return " / ".join(map(str, counts)) or "–", duration(sum(r["seconds"] for r in mine)) if mine else "–"


def to_markdown(table: Table, rows: Sequence[Metrics]) -> str:
    """A table of success in % with 95 % intervals, the paper's figure in bold brackets beside where there is one."""
    head = [table.corner, *table.columns, "n", "time"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for row in table.rows:
        cells = [_text(_cell(rows, row, column)) for column in table.columns]
        lines.append("| " + " | ".join([row, *cells, *_tail(rows, row)]) + " |")
    return "\n".join(lines)


def _text(r: Metrics) -> str:
    if not r or r["success"] is None:
        return "–"
    text = f"{percent(r['success'], 0)} <sub>{percent(r['low'], 0)}–{percent(r['high'], 0)}</sub>"
    text += f" **[{percent(r['paper'])}]**" if r["paper"] is not None else ""
    return text


def to_html(table: Table, rows: Sequence[Metrics]) -> str:
    """The same for a report; under each rate its interval and the paper's figure."""
    head = "<tr>" + "".join(f'<th scope="col">{escape(t)}</th>' for t in (table.corner, *table.columns, "n", "time"))
    body = []
    for row in table.rows:
        cells = []
        for column in table.columns:
            r = _cell(rows, row, column)
            known = bool(r) and r["success"] is not None
            kind = "control" if column in CONTROLS else ""
            small = [f"{percent(r['low'], 0)} – {percent(r['high'], 0)}"] if known else []
            small += [f"paper {percent(r['paper'])}"] if known and r["paper"] is not None else []
            value = percent(r["success"]) if known else "–"
            small_print = "".join(f"<small>{escape(s)}</small>" for s in small)
            cells.append(f'<td class="{kind}">{value}{small_print}</td>')
        ends = "".join(f"<td>{escape(t)}</td>" for t in _tail(rows, row))
        body.append(f'<tr><th scope="row">{escape(row)}</th>{"".join(cells)}{ends}</tr>')
    caption = "Images fooled, % of those right when clean; small print: 95 % interval, and the paper’s own figure. "
    caption += "Grey columns are controls: nobody searched for anything. " if set(CONTROLS) & set(table.columns) else ""
    caption += "Time is of showing and judging, and counts an attack in every row that it stands in. " + table.note
    return tables.framed(head + "</tr>", body, escape(caption, quote=False), "grid")


def visibility_html(table: Table, rows: Sequence[Metrics]) -> str:
    """How visible the changes of a table's attacks are; empty where none was measured."""
    if not table.visible:
        return ""
    units = (("psnr", "PSNR, dB", 1), ("ssim", "SSIM", 3), ("ciede2000", "CIEDE2000", 2), ("largest", "largest", 0))
    wide = f' scope="colgroup" colspan="{len(units)}"'
    head = f'<tr><th rowspan="2">{escape(table.corner)}</th>'
    head += "".join(f"<th{wide}>{escape(c)}</th>" for c in table.visible) + '</tr><tr class="sub">'
    head += "".join(f'<th scope="col">{title}</th>' for _ in table.visible for _, title, _ in units) + "</tr>"
    body = []
    for row in table.rows:
        found = [_cell(rows, row, c) for c in table.visible]
        cells = [f"<td>{_figure(r, key, digits)}</td>" for r in found for key, _, digits in units]
        body.append(f'<tr><th scope="row">{escape(row)}</th>{"".join(cells)}</tr>')
    caption = "How visible the noise is: mean PSNR, SSIM, colour difference, and the largest change in 1/255, of the "
    caption += "photo against the one without noise for MA, of the image against the clean one for BIM."
    return tables.framed(head, body, caption, "grid")


def visibility_markdown(table: Table, rows: Sequence[Metrics]) -> str:
    head = [table.corner, *(f"{c}: {t}" for c in table.visible for t in ("PSNR, dB", "SSIM", "CIEDE2000", "largest"))]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for row in table.rows:
        found = [_cell(rows, row, c) for c in table.visible]
        keys = (("psnr", 1), ("ssim", 3), ("ciede2000", 2), ("largest", 0))
        lines.append("| " + " | ".join([row, *(_figure(r, k, d) for r in found for k, d in keys)]) + " |")
    return "\n".join(lines)


def _figure(r: Metrics, key: str, digits: int) -> str:
    value = r.get(key)
    return "–" if value is None else f"{255 * value if key == 'largest' else value:.{digits}f}"


class Verdict(NamedTuple):
    """What one table says of the moiré and of the noise, as rates of images fooled; `eps` is the attack's."""

    row: str
    eps: float
    photo: float
    random: float
    attack: float
    counted: int
    others: str  # of the other rows, in words

    @property
    def moire(self) -> float | None:
        """Share of the attack's success that its photo has without any noise."""
        return min(1.0, self.photo / self.attack) if self.attack > 0 else None

    def __str__(self) -> str:
        text = f"{self.row}: the photo alone fools {percent(self.photo, 0)} % of the images, random noise "
        text += f"{percent(self.random, 0)} %, the attack {percent(self.attack, 0)} %. "
        if self.moire is not None:
            text += f"Of what the attack fools, {percent(self.moire, 0)} % is the photo’s doing and "
            text += f"{percent(1 - self.moire, 0)} % the noise’s. "
        return (text + self.others).strip()


ATTACK = ("worst case", "MA", "untargeted MA", "MA ε = 4")


def verdict(table: Table, rows: Sequence[Metrics]) -> Verdict | None:
    """The verdict of a table on its row at ε = 4, or its first, by the strongest attack of `ATTACK` that it has; None
    where it has none beside its photo."""
    row = "ε = 4" if "ε = 4" in table.rows else table.rows[0]
    attack = next((c for c in ATTACK if c in table.columns), None)
    photo, random, hit = (_cell(rows, row, c) for c in (NOISELESS, RANDOM, attack))
    if attack is None or not _known(photo, random, hit):
        return None
    pairs = [(r, _cell(rows, r, NOISELESS), _cell(rows, r, attack)) for r in table.rows if r != row]
    found = [(r, p["success"], a["success"]) for r, p, a in pairs if _known(p, a)]
    others = ""
    if found:
        name, alone, both = max(found, key=lambda x: x[2] - x[1])
        least, most = (f(p for _, p, _ in found) for f in (min, max))
        spread = f"{percent(least, 0)} %" if percent(least, 0) == percent(most, 0) else ""
        spread = spread or f"{percent(least, 0)} to {percent(most, 0)} %"
        added = percent(max(0.0, both - alone), 0)
        plural = "" if added == "1" else "s"
        others = (
            f"In the other rows the photo alone fools {spread}; the noise adds at most {added} point{plural} ({name})."
        )
    return Verdict(row, hit["eps"], photo["success"], random["success"], hit["success"], hit["counted"], others)


def _known(*cells: Metrics) -> bool:
    return all(c and c["success"] is not None for c in cells)


# of the tables that nobody attacks in: a lead, the column with moiré and the one without
UNATTACKED = {
    "threat": ("Over all angles", "all", "all, no moiré"),
    "unseen": ("Without any attacker", NOISELESS, "no moiré"),
}


def natural(table: Table, rows: Sequence[Metrics]) -> str:
    """What displays and cameras, or scenes, say in a sentence; empty for any other table."""
    if table.name not in UNATTACKED:
        return ""
    lead, photo, plain = UNATTACKED[table.name]
    found = [(r, _cell(rows, r, photo), _cell(rows, r, plain)) for r in table.rows]
    known = [(r, a["success"], b["success"]) for r, a, b in found if _known(a, b)]
    if not known:
        return ""
    (worst, a, b), (best, c, d) = (f(known, key=lambda x: x[1] - x[2]) for f in (max, min))
    return (
        f"{lead} the moiré adds most for {worst}: {percent(a, 0)} % fooled, against {percent(b, 0)} % without "
        f"moiré; least for {best}: {percent(c, 0)} against {percent(d, 0)} %."
    )


def verdicts_html(results: Sequence[tuple[Table, Sequence[Metrics]]]) -> str:
    """Table by table, what is the moiré's doing and what the noise's; empty where none can say."""
    body, said = [], [(t, verdict(t, rows)) for t, rows in results]
    for table, v in said:
        if v:
            share = v.moire
            cells = [percent(x, 0) for x in (v.photo, v.random, v.attack, share, None if share is None else 1 - share)]
            body.append(
                f'<tr><th scope="row">{escape(table.title)}<small>{escape(v.row)}</small></th>'
                + "".join(f"<td>{c}</td>" for c in cells)
                + f'<td class="says">{escape(v.others)}</td></tr>'
            )
    if not body:
        return ""
    titles = ("table", "photo alone, %", "random noise, %", "attack, %", "the photo’s share, %", "the noise’s share, %")
    head = "<tr>" + "".join(f'<th scope="col">{t}</th>' for t in (*titles, "")) + "</tr>"
    caption = "Images fooled, and whose doing it is: the photo’s share is what it fools without any noise, over what "
    caption += "the attack fools."
    return tables.framed(head, body, caption, "grid verdict")
