"""The report: whole, self-contained, escaped, and honest about what the numbers do not show."""

import base64
import copy
import html
import re
from dataclasses import replace
from xml.etree import ElementTree

import matplotlib
import numpy as np
import pytest

from tests.training.report.conftest import run_metrics
from tests.training.report.elements import Elements
from training import report


def read(tmp_path, metrics, pictures=()):
    path = tmp_path / "report.html"
    report.write_run(path, metrics, pictures)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    return Elements(path.read_text("utf-8"))


@pytest.fixture(scope="module")
def raw(tmp_path_factory):
    """The page of a run, without pictures; matplotlib is as it was."""
    path, before = tmp_path_factory.mktemp("run") / "report.html", dict(matplotlib.rcParams)
    report.write_run(path, run_metrics(), ())
    assert dict(matplotlib.rcParams) == before
    return path.read_text("utf-8")


def test_accuracy_is_drawn_against_the_visibility_of_noise():
    """A line of the Moiré Attack's bounds, targets left out, and PGD, of both networks."""
    series = report.run_view(run_metrics())["visibility"]
    names = ["moire_at: Moiré Attack", "moire_at: PGD on pixels"]
    names += ["baseline: Moiré Attack", "baseline: PGD on pixels"]
    assert [one.name for one in series] == names
    assert [len(one.points) for one in series] == [3, 1, 3, 1]
    assert [point[:2] for point in series[0].points] == [(38.2, 0.8), (38.2, 0.76), (38.2, 0.5)]
    assert series[3].points[0][1] == 0 and [one.model for one in series] == [0, 0, 1, 1]


def test_plots_are_whole_svg_that_ask_for_nothing(raw):
    plots = [image["src"] for image in Elements(raw).of("img")]
    assert len(plots) == 3  # accuracy by PSNR, loss and accuracy by epoch
    for uri in plots:
        used = []
        for element in ElementTree.fromstring(base64.b64decode(uri.split("base64,")[1])).iter():
            used += [value for key, value in element.attrib.items() if key.endswith("href")]
        assert used and all(value.startswith("#") for value in used)


def test_names_are_escaped_everywhere(tmp_path, metrics, pictures):
    evil = "<b>&\"$x$'</b>"
    for side in (metrics, metrics.baseline):
        side.reattack[-1]["name"] = evil
    metrics.gain[evil], metrics.gain_interval[evil] = 0.5, [0.4, 0.6]
    metrics = replace(
        metrics,
        **dict.fromkeys(("recipe", "scene_name", "command", "plan"), evil),
        trust=[{"name": evil, "verdict": "fail", "says": evil}],
        config={evil: {evil: evil}},
        environment={evil: evil},
        time={evil: 1.0},
        baseline=replace(metrics.baseline, recipe=evil),
    )
    cell = pictures[0]["cells"][0]
    pictures[0]["label"] = cell["title"] = evil
    cell["predictions"] = [(evil, evil, False)]
    # how Python hands over a folder named in Latin-1
    pictures[0]["cells"][1]["title"] = "caf\udce9"
    page = read(tmp_path, metrics, pictures)
    assert evil in page.text and "caf?" in page.text
    # the page's own <b> holds nothing but a sign, and closes in order, which Elements has checked
    raw = (tmp_path / "report.html").read_text("utf-8")
    assert set(re.findall(r"<b>(.*?)</b>", raw)) == {"✗"} and '<b>&"' not in raw


@pytest.mark.parametrize("is_trained", [True, False])
def test_parts_that_are_not_known_are_left_out(tmp_path, raw, alone, is_trained):
    shown = alone if is_trained else replace(alone, train=None, recipe="pretrained")
    text = read(tmp_path, shown).text
    assert "No baseline was attacked" in text and "No baseline was attacked" not in raw
    for words in ("training time", "epoch by epoch"):
        assert (words in text) == is_trained
    assert ("small_resnet: 76" in text) == (not is_trained)
    assert "None" not in text.replace("root: None", "") and "nan" not in text


def test_pictures_have_a_section_of_their_own(tmp_path, raw, metrics, pictures):
    page = read(tmp_path, metrics, pictures)
    assert len(page.of("h2")) == len(Elements(raw).of("h2")) + 1
    small, large = (i for i in page.of("img") if i["src"].startswith("data:image/png"))
    assert (small["width"], large["width"]) == ("160", "299")
    assert "pixelated" in small["style"] and large["style"] is None


def test_a_model_that_is_never_right_has_a_report(tmp_path, alone):
    for row in alone.reattack:
        row |= {"success": None, "success_interval": [0.0, 1.0], "counted": 0}
    text = read(tmp_path, replace(alone, clean_accuracy=0.0)).text
    printed = "\n".join(report.run_parts(alone))
    for words in (text.split("What was run")[0], printed):
        assert not re.search(r"\b(nan|inf|None)\b", words)


def test_a_collapse_of_training_is_told(tmp_path, raw, metrics):
    collapsed = replace(metrics, train=replace(metrics.train, collapsed_at=0))
    text = read(tmp_path, collapsed).text
    assert "In epoch 1 this model collapsed" in text
    assert "catastrophic overfitting" in text and "catastrophic overfitting" not in raw


def test_a_failure_leaves_the_older_report_whole(tmp_path, metrics, pictures, monkeypatch):
    path = tmp_path / "report.html"
    path.write_text("older")
    broken = copy.deepcopy(pictures)
    broken[0]["cells"][1]["image"] = np.zeros((8, 8, 3))
    with pytest.raises(TypeError, match="Cannot handle this data type"):
        report.write_run(path, metrics, broken)

    def full(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(OSError, match="no space"):
        report.write_run(path, metrics, pictures)
    assert path.read_text() == "older" and list(tmp_path.iterdir()) == [path]


def ranges(text, kind):
    """(left, width) of the intervals and the left of the dots that a kind of side has."""
    bars = re.findall(rf'class="range {kind}"><i style="left: ([\d.]+)%; width: ([\d.]+)%">', text)
    dots = re.findall(rf'class="range {kind}">(?:<i [^>]*></i>)?<b style="left: ([\d.]+)%">', text)
    return [(float(a), float(b)) for a, b in bars], [float(d) for d in dots]


def test_the_ladder_is_drawn_where_its_numbers_are(raw, metrics):
    for kind, side in (("ours", metrics), ("baseline", metrics.baseline)):
        bars, dots = ranges(raw, kind)
        rows = side.reattack
        assert dots == pytest.approx([100 * row["accuracy"] for row in rows], abs=0.01)
        lows = [100 * row["accuracy_interval"][0] for row in rows]
        assert [left for left, _ in bars] == pytest.approx(lows, abs=0.01)
        highs = [100 * row["accuracy_interval"][1] for row in rows]
        assert [left + width for left, width in bars] == pytest.approx(highs, abs=0.02)


def test_every_attack_row_says_what_its_noise_is(raw, metrics):
    text = Elements(raw).text
    section = text[text.index("What the noise is in the photo") :].partition("Training")[0]
    assert section.count("38.2") == 5 and section.count("0.987") == 5
    printed = "\n".join(report.run_parts(metrics)).splitlines()
    attacks = [line for line in printed if "Moiré Attack" in line or line.startswith("PGD")]
    assert len(attacks) == 5 and all(" 12  38.2 " in line for line in attacks)
    assert "38.2" not in printed[2] and "38.2" not in printed[4]  # no controls


def test_numbers_stay_on_one_line_with_their_units(raw):
    assert "8\N{NO-BREAK SPACE}% to 76\N{NO-BREAK SPACE}%</h1>" in html.unescape(raw)
    assert "n\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}200" in html.unescape(raw)


def test_lpips_is_shown_where_it_was_measured(tmp_path, raw, metrics):
    assert "LPIPS" not in raw
    for row in metrics.reattack:
        row |= {"psnr": 30.0, "ssim": 0.9, "largest": 0.1, "lpips": 0.1234}
    shown = read(tmp_path, metrics)
    assert "LPIPS" in shown.text and shown.text.count("0.123") == len(metrics.reattack)
