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

from tests.training.report.elements import Elements
from training import report
from training.report.terminal import plain


def read(tmp_path, metrics, pictures=()):
    path = tmp_path / "report.html"
    report.write_run(path, metrics, pictures)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    return Elements(path.read_text("utf-8"))


def headings(page):
    return len(page.of("h2"))


def test_plots_are_whole_svg_that_ask_for_nothing(tmp_path, metrics):
    plain = [image["src"] for image in read(tmp_path, metrics).of("img")]
    assert len(plain) == 2  # loss and accuracy by epoch
    for uri in plain:
        svg = base64.b64decode(uri.split("base64,")[1])
        used = [
            v
            for e in ElementTree.fromstring(svg).iter()
            for k, v in e.attrib.items()
            if k.endswith("href")
        ]
        assert used and all(v.startswith("#") for v in used)


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
    page = read(tmp_path, metrics, pictures)
    assert evil in page.text
    # the page's own <b> holds nothing but a sign, and closes in order, which Elements has checked
    raw = (tmp_path / "report.html").read_text("utf-8")
    assert set(re.findall(r"<b>(.*?)</b>", raw)) == {"✗"} and '<b>&"' not in raw


def test_a_name_that_is_no_unicode_does_not_stop_the_report(tmp_path, metrics, pictures):
    pictures[0]["label"] = "caf\udce9"  # how Python hands over a folder named in Latin-1
    assert "caf?" in read(tmp_path, metrics, pictures).text


@pytest.mark.parametrize("is_trained", [True, False])
def test_parts_that_are_not_known_are_left_out(tmp_path, metrics, alone, is_trained):
    shown = alone if is_trained else replace(alone, train=None, recipe="pretrained")
    text = read(tmp_path, shown).text
    assert "No baseline was attacked" in text
    for words in ("training time", "epoch by epoch"):
        assert (words in text) == is_trained
    assert ("small_resnet: 76" in text) == (not is_trained)
    assert "None" not in text.replace("root: None", "") and "nan" not in text
    assert "No baseline was attacked" not in read(tmp_path, metrics).text


def test_pictures_have_a_section_of_their_own(tmp_path, metrics, pictures):
    assert headings(read(tmp_path, metrics, pictures)) == headings(read(tmp_path, metrics)) + 1
    images = read(tmp_path, metrics, pictures).of("img")
    small, large = (image for image in images if image["src"].startswith("data:image/png"))
    assert (small["width"], large["width"]) == ("160", "299")
    assert "pixelated" in small["style"] and large["style"] is None


def test_a_model_that_is_never_right_has_a_report(tmp_path, alone):
    for row in alone.reattack:
        row |= {"success": None, "success_interval": [0.0, 1.0], "counted": 0}
    text = read(tmp_path, replace(alone, clean_accuracy=0.0)).text
    printed = plain(report.run_parts(alone))
    for words in (text.split("What was run")[0], printed):
        assert not re.search(r"\b(nan|inf|None)\b", words)


@pytest.mark.parametrize(("epoch", "said"), [(None, False), (0, True), (3, True)])
def test_a_collapse_of_training_is_told(metrics, epoch, said, tmp_path):
    text = read(tmp_path, replace(metrics, train=replace(metrics.train, collapsed_at=epoch))).text
    assert (f"In epoch {(epoch or 0) + 1} this model collapsed" in text) == said
    assert ("catastrophic overfitting" in text) == said


def test_a_failure_leaves_the_older_report_whole(tmp_path, metrics, pictures, monkeypatch):
    path = tmp_path / "report.html"
    path.write_text("older")
    broken = copy.deepcopy(pictures)
    broken[0]["cells"][1]["image"] = np.zeros((8, 8, 3))
    with pytest.raises(
        ValueError, match=r"'noise, × 8' must be a uint8 array .* got float64 \(8, 8, 3\)"
    ):
        report.write_run(path, metrics, broken)

    def full(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(OSError, match="no space"):
        report.write_run(path, metrics, pictures)
    assert path.read_text() == "older" and list(tmp_path.iterdir()) == [path]


def test_plots_leave_matplotlib_as_it_was(metrics, tmp_path):
    before = dict(matplotlib.rcParams)
    read(tmp_path, metrics)
    assert dict(matplotlib.rcParams) == before


def ranges(text, kind):
    """(left, width) of the intervals and the left of the dots that a kind of side has."""
    bars = re.findall(rf'class="range {kind}"><i style="left: ([\d.]+)%; width: ([\d.]+)%">', text)
    dots = re.findall(rf'class="range {kind}">(?:<i [^>]*></i>)?<b style="left: ([\d.]+)%">', text)
    return [(float(a), float(b)) for a, b in bars], [float(d) for d in dots]


def test_the_ladder_is_drawn_where_its_numbers_are(tmp_path, metrics):
    read(tmp_path, metrics)
    text = (tmp_path / "report.html").read_text("utf-8")
    for kind, side in (("ours", metrics), ("baseline", metrics.baseline)):
        bars, dots = ranges(text, kind)
        rows = side.reattack
        assert dots == pytest.approx([100 * row["accuracy"] for row in rows], abs=0.01)
        lows = [100 * row["accuracy_interval"][0] for row in rows]
        assert [left for left, _ in bars] == pytest.approx(lows, abs=0.01)
        highs = [100 * row["accuracy_interval"][1] for row in rows]
        assert [left + width for left, width in bars] == pytest.approx(highs, abs=0.02)


def test_every_attack_row_says_what_its_noise_is(tmp_path, metrics):
    text = read(tmp_path, metrics).text
    section = text[text.index("What the noise is in the photo") :].partition("Training")[0]
    assert section.count("38.2") == 5 and section.count("0.987") == 5
    printed = plain(report.run_parts(metrics)).splitlines()
    attacks = [line for line in printed if "Moiré Attack" in line or line.startswith("PGD")]
    assert len(attacks) == 5 and all(" 12  38.2 " in line for line in attacks)
    assert "38.2" not in printed[2] and "38.2" not in printed[4]  # no controls


def test_numbers_stay_on_one_line_with_their_units(tmp_path, metrics):
    read(tmp_path, metrics)
    raw = html.unescape((tmp_path / "report.html").read_text("utf-8"))
    assert "8\N{NO-BREAK SPACE}% to 76\N{NO-BREAK SPACE}%</h1>" in raw
    assert "n\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}200" in raw


def test_lpips_is_shown_where_it_was_measured(tmp_path, metrics):
    without = read(tmp_path, metrics)
    assert "LPIPS" not in without.text
    for row in metrics.reattack:
        row |= {"psnr": 30.0, "ssim": 0.9, "largest": 0.1, "lpips": 0.1234}
    shown = read(tmp_path, metrics)
    assert "LPIPS" in shown.text and shown.text.count("0.123") == len(metrics.reattack)
