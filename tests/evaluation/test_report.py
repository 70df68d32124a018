"""The report: whole, self-contained, escaped, and honest about what the numbers do not show."""

import base64
import copy
import html
import math
import re
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest

from moireaug.evaluation import plots, report
from moireaug.evaluation.statistics import wilson
from moireaug.evaluation.words import duration, headline, main_row

N, COUNTED = 200, 180
RUNGS = (
    ("clean", "clean image", 0),
    ("no_moire", "photo, no moiré", 0),
    ("moire", "photo with moiré, no noise", 0),
    ("ma_2", "Moiré Attack 2/255", 2 / 255),
    ("ma_4", "Moiré Attack 4/255", 4 / 255),
    ("ma_8", "Moiré Attack 8/255", 8 / 255),
    ("ma_4_targeted", "targeted Moiré Attack 4/255", 4 / 255),
    ("pgd_4", "PGD on pixels 4/255", 4 / 255),
)


def rows(accuracies, fooled):
    return [
        {
            "name": name,
            "title": title,
            "eps": eps,
            "targeted": name.endswith("targeted"),
            "accuracy": a,
            "accuracy_interval": list(wilson(round(a * N), N)),
            "success": f,
            "success_interval": list(wilson(round(f * COUNTED), COUNTED)),
            "n": N,
            "counted": COUNTED,
            "seconds": 1.5,
        }
        for (name, title, eps), a, f in zip(RUNGS, accuracies, fooled, strict=True)
    ]


def run(recipe, accuracies, fooled, seconds):
    history = [
        {"epoch": i, "loss": 2.0 - i, "clean": 0.4 + 0.2 * i, "perturbed": 0.3, "seconds": 9.0} for i in range(2)
    ]
    return {
        "recipe": recipe,
        "seed": 0,
        "data": "signs",
        "model": "small_resnet",
        "clean_accuracy": accuracies[0],
        "train": {
            "seconds": seconds,
            "epochs": 2,
            "best_epoch": 1,
            "images_per_second": 100.0,
            "passes": 3.25,
            "history": history,
        },
        "baseline": None,
        "reattack": rows(accuracies, fooled),
    }


@pytest.fixture
def metrics():
    ours = run("moire_at", (0.9, 0.9, 0.9, 0.8, 0.76, 0.5, 0.8, 0.6), (0, 0.02, 0.03, 0.1, 0.18, 0.5, 0.1, 0.3), 210.0)
    theirs = run("clean", (0.95, 0.8, 0.5, 0.2, 0.08, 0, 0.2, 0), (0, 0.2, 0.46, 0.8, 0.92, 1, 0.6, 1), 70.0)
    gains = {
        o["name"]: o["accuracy"] - t["accuracy"] for o, t in zip(ours["reattack"], theirs["reattack"], strict=True)
    }
    return ours | {
        "baseline": theirs,
        "gain": gains,
        "gain_interval": {name: [gain - 0.06, gain + 0.06] for name, gain in gains.items()},
        "time": {"data": 1.0, "train": 210.0, "re-attack": 60.0, "pictures": 0.5},
        "scene": {"panel": {"scale": [1.0, 2.0]}},
        "plan": "12 effects are computed, in this order",
        "scene_name": "screen_photo",
        "config": {"data": {"name": "signs", "root": None}, "empty": {}},
        "environment": {"python": "3.11.7", "threads": 2},
        "command": "python training/fit.py recipe=moire_at",
    }


@pytest.fixture
def pictures():
    def image(side):
        return np.random.default_rng(side).integers(0, 256, (side, side, 3), dtype=np.uint8)

    cell = {
        "title": "clean image",
        "image": image(32),
        "predictions": [("moire_at", "stop", True), ("clean", "go", False)],
    }
    return [{"label": "stop", "cells": [cell, {"title": "noise, × 8", "image": image(299)}]}]


class Page(HTMLParser):
    """Every tag with its attributes, the text, and whether the tags close in order."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.text, self.open = [], "", []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "br", "source"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def read(tmp_path, metrics, pictures=None):
    path = tmp_path / "report.html"
    report.write(path, metrics, pictures)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    return Page(path.read_text("utf-8"))


def headings(page):
    return sum(tag == "h2" for tag, _ in page.tags)


def test_page_needs_nothing_but_itself(tmp_path, metrics, pictures):
    page = read(tmp_path, metrics, pictures)
    assert not {"script", "link", "iframe", "object"} & {tag for tag, _ in page.tags}
    for tag, attrs in page.tags:
        assert tag != "a" or attrs["href"].startswith("#")
        assert all(attrs[k].startswith("data:") for k in ("src", "srcset") if k in attrs)
        assert tag != "img" or attrs["alt"]
    raw = (tmp_path / "report.html").read_text("utf-8")
    assert "http" not in re.sub(r"data:[^\"]*", "", raw) and "url(" not in raw


def test_plots_are_whole_svg_that_ask_for_nothing(tmp_path, metrics):
    plain = [v for _, a in read(tmp_path, metrics).tags for k, v in a.items() if k in ("src", "srcset")]
    assert len(plain) == 4  # ladder and curves, each wide and narrow
    for uri in plain:
        svg = base64.b64decode(uri.split("base64,")[1])
        used = [v for e in ElementTree.fromstring(svg).iter() for k, v in e.attrib.items() if k.endswith("href")]
        assert used and all(v.startswith("#") for v in used)


def test_names_are_escaped_everywhere(tmp_path, metrics, pictures):
    evil = "<b>&\"$x$'</b>"
    metrics["recipe"] = metrics["baseline"]["recipe"] = metrics["scene_name"] = metrics["command"] = metrics["plan"] = (
        evil
    )
    metrics["config"], metrics["environment"], metrics["time"] = {evil: {evil: evil}}, {evil: evil}, {evil: 1.0}
    for row in metrics["reattack"]:
        row["title"] = evil
    cell = pictures[0]["cells"][0]
    pictures[0]["label"] = cell["title"] = evil
    cell["predictions"] = [(evil, evil, False)]
    page = read(tmp_path, metrics, pictures)
    assert evil in page.text
    # the page's own <b> holds nothing but a sign, and closes in order, which Page has checked
    assert set(re.findall(r"<b>(.*?)</b>", (tmp_path / "report.html").read_text("utf-8"))) == {"✗"}


def test_a_name_that_is_no_unicode_does_not_stop_the_report(tmp_path, metrics, pictures):
    pictures[0]["label"] = "caf\udce9"  # how Python hands over a folder named in Latin-1
    assert "caf?" in read(tmp_path, metrics, pictures).text


@pytest.mark.parametrize("without", [(), ("baseline",), ("baseline", "train"), ("baseline", "train", "time", "config")])
def test_parts_that_are_not_known_are_left_out(tmp_path, metrics, without):
    text = read(tmp_path, metrics | dict.fromkeys(without)).text
    assert ("No baseline was attacked" in text) == ("baseline" in without)
    assert ("training time" in text) == ("train" not in without)
    assert ("Configuration" in text) == ("config" not in without)
    assert "None" not in text.replace("root: None", "") and "nan" not in text


def test_pictures_have_a_section_of_their_own(tmp_path, metrics, pictures):
    assert headings(read(tmp_path, metrics, pictures)) == headings(read(tmp_path, metrics)) + 1
    small, large = [
        a for tag, a in read(tmp_path, metrics, pictures).tags if a.get("src", "").startswith("data:image/png")
    ]
    assert (small["width"], large["width"]) == ("160", "299")
    assert "pixelated" in small["style"] and "style" not in large


def test_training_without_history_has_no_curves(tmp_path, metrics):
    for side in (metrics, metrics["baseline"]):
        del side["train"]["history"]
    text = read(tmp_path, metrics).text
    assert "epoch by epoch" not in text and "training time" in text


@pytest.mark.parametrize("unknown", [None, math.nan, math.inf])
def test_unknown_numbers_crash_nothing(tmp_path, metrics, unknown):
    def forget(tree):
        if isinstance(tree, dict):
            return {k: v if k in ("name", "seed", "n", "counted") else forget(v) for k, v in tree.items()}
        if isinstance(tree, list):
            return [forget(v) for v in tree]
        return unknown if isinstance(tree, int | float) and not isinstance(tree, bool) else tree

    forgotten = forget(metrics)
    text = read(tmp_path, forgotten).text
    report.summary(forgotten)
    head = text.split("How to read this")[0].split("What was run")[0]
    assert not re.search(r"\b(nan|inf|None)\b", head)


@pytest.mark.parametrize(("epoch", "said"), [(None, False), (0, True), (3, True)])
def test_a_collapse_of_training_is_told(metrics, epoch, said, tmp_path):
    metrics["train"]["collapsed_at"] = epoch
    report.write(tmp_path / "report.html", metrics)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert (f"In epoch {epoch} this model collapsed" in text) == said
    assert ("catastrophic overfitting" in text) == said


@pytest.mark.parametrize("least", [{}, {"recipe": "x"}, {"reattack": []}, {"recipe": "x", "baseline": {}, "train": {}}])
def test_the_least_that_can_be_reported(tmp_path, least):
    assert "not attacked" in read(tmp_path, least).text
    assert "not attacked" in report.summary(least)


def test_headline_says_what_was_gained_and_paid(metrics):
    title, (lead, shares) = headline(metrics)
    assert title == "moire_at raises accuracy under the Moiré Attack from 8 % to 76 %"
    assert "fooled the plainly trained model on 92 % of the images that it had right; it fools moire_at on 18 %" in lead
    assert "rose from 8 % to 76 % (+68 points, 95 % interval +62 to +74, n = 200)" in lead
    assert "clean accuracy went from 95.0 % to 90.0 %" in lead
    assert "Training took 3 min 30 s, 3.0 times the 1 min 10 s of the baseline." in lead
    assert (
        "fools the plainly trained model on 20 %; to that the moiré adds 26 and the attacker’s noise 46 points"
        in shares
    )
    assert "with moire_at it is 2 %, 1 and 15 points" in shares


def test_headline_of_a_loss(metrics):
    metrics["reattack"], metrics["baseline"]["reattack"] = metrics["baseline"]["reattack"], metrics["reattack"]
    metrics["gain"] = {k: -v for k, v in metrics["gain"].items()}
    metrics["gain_interval"] = {k: [-high, -low] for k, (low, high) in metrics["gain_interval"].items()}
    title, (lead, _) = headline(metrics)
    assert title == "moire_at lowers accuracy under the Moiré Attack from 76 % to 8 %"
    assert "fell from 76 % to 8 % (−68 points, 95 % interval −74 to −62" in lead


@pytest.mark.parametrize("interval", [[-0.01, 0.05], [0.0, 0.04], [-0.03, 0.0]])
def test_headline_of_a_difference_that_may_be_none(metrics, interval):
    metrics["gain"]["ma_4"], metrics["gain_interval"]["ma_4"] = 0.02, interval
    title, (lead, _) = headline(metrics)
    assert "does not measurably change" in title
    assert "cannot tell from none" in lead and "rose" not in lead and "fell" not in lead


def test_headline_is_about_the_plain_attack_at_the_middle_eps(metrics):
    assert main_row(metrics)["name"] == "ma_4"
    metrics["reattack"] = [r for r in metrics["reattack"] if not r["name"].startswith("ma_")]
    title, _ = headline(metrics)
    assert "PGD on pixels 4/255" in title


def test_a_failure_leaves_the_older_report_whole(tmp_path, metrics, pictures, monkeypatch):
    path = tmp_path / "report.html"
    path.write_text("older")
    broken = copy.deepcopy(pictures)
    broken[0]["cells"][1]["image"] = np.zeros((8, 8, 3))
    with pytest.raises(ValueError, match=r"'noise, × 8' must be a uint8 array .* got float64 \(8, 8, 3\)"):
        report.write(path, metrics, broken)

    def full(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(OSError, match="no space"):
        report.write(path, metrics, pictures)
    assert path.read_text() == "older" and list(tmp_path.iterdir()) == [path]


def test_plots_leave_matplotlib_as_it_was(metrics):
    import matplotlib

    before = dict(matplotlib.rcParams)
    gains = {"ma_4": (0.5, None)}
    plots.ladder(metrics["reattack"], [], ("a", "b"), gains)
    assert plots.curves((metrics["train"], None), ("a", "b"))
    assert plots.curves((None, {"history": [{"loss": math.nan}]}), ("a", "b")) is None
    assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize("baseline", [True, False])
def test_summary_is_an_aligned_table_of_at_most_100_columns(metrics, baseline):
    metrics["recipe"] = "a_recipe_with_a_very_long_name"
    metrics["data"] = metrics["model"] = metrics["scene_name"] = "x" * 80
    metrics["reattack"][0]["title"] = "t" * 80
    if not baseline:
        metrics["baseline"] = None
    lines = report.summary(metrics).splitlines()
    assert max(map(len, lines)) <= 100
    assert len({len(line) for line in lines[1 : 2 + len(RUNGS)]}) == 1
    assert "n = 200" in lines[0] and lines[-1].startswith("training: ") and "3 min 30 s" in lines[-1]
    assert ("+68.0  [+62.0, +74.0]" in "\n".join(lines)) == baseline


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(None, "–"), (0.04, "0.0 s"), (59.94, "59.9 s"), (59.97, "1 min 0 s"), (210.3, "3 min 30 s"), (3900, "1 h 5 min")],
)
def test_duration(seconds, said):
    assert duration(seconds) == said


def test_numbers_stay_on_one_line_with_their_units(tmp_path, metrics):
    read(tmp_path, metrics)
    raw = html.unescape((tmp_path / "report.html").read_text("utf-8"))
    assert (
        "8\N{NO-BREAK SPACE}% to 76\N{NO-BREAK SPACE}%</h1>" in raw
        and "n\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}200" in raw
    )
