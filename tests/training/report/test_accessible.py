"""Every page can be read without a mouse, without colours, and by a screen reader."""

import re
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import pandas as pd
import pytest
import torch

from moireaug import Scene
from tests.training.report.conftest import run_metrics, run_pictures, suite_metrics
from tests.training.report.elements import Elements
from training import calibrate, report
from training.calibration.compare import Crops, compare_statistics
from training.calibration.fit import FittedScene
from training.demoireing import report as demoireing
from training.demoireing.testing import GroupedPair
from training.photographs.statistics import STATISTICS
from training.report import page

OUTSIDE = ("script", "link", "iframe", "object", "embed", "video", "audio")


def meta_content(elements, name):
    return [meta["content"] for meta in elements.of("meta") if meta["name"] == name]


def headings_skip_no_level(elements):
    levels = [int(heading.tag[1]) for heading in elements.of("h1", "h2", "h3", "h4")]
    steps = [later - earlier for earlier, later in pairwise(levels)]
    return levels[0] == 1 and levels.count(1) == 1 and max(steps) <= 1


def pictures_have_texts_of_their_own(elements):
    texts = [(image["alt"] or "").strip() for image in elements.of("img")]
    return all(texts) and len(texts) == len(set(texts))


def every_table_header_has_a_text_and_a_scope(elements):
    allowed = ("col", "row", "colgroup", "rowgroup")
    return all(head["scope"] in allowed and head.text.strip() for head in elements.of("th"))


def every_table_has_a_name(elements):
    titles = [elements.named(table["aria-labelledby"]) for table in elements.of("table")]
    return all(len(named) == 1 and named[0].text.strip() for named in titles)


def what_scrolls_can_be_reached_and_has_a_name(elements):
    boxes = [box for box in elements.of("div") if box["class"] == "scroll"]
    if len(boxes) != len(elements.of("table")):
        return False
    for box in [*boxes, *elements.of("pre")]:
        named = box["aria-label"] or elements.named(box["aria-labelledby"])
        if not named or box["role"] != "region" or box["tabindex"] != "0":
            return False
    return True


def what_is_drawn_is_hidden(elements):
    """Its numbers stand beside it."""
    drawn = [span for span in elements.of("span") if (span["class"] or "").startswith("range")]
    return all(span["aria-hidden"] == "true" for span in drawn)


def nothing_comes_from_outside(elements):
    links = []
    for name in ("src", "srcset", "href", "data", "poster"):
        links += [element[name] for element in elements.found if element[name]]
    inside = all(link.startswith(("data:", "#")) for link in links)
    style = "".join(style.text for style in elements.of("style"))
    return inside and not elements.of(*OUTSIDE) and not re.search(r"url\(|@import|http", style)


def the_language_is_said(elements):
    return [html["lang"] for html in elements.of("html")] == ["en"]


def it_takes_the_width_of_a_phone(elements):
    return meta_content(elements, "viewport") == ["width=device-width, initial-scale=1"]


def it_follows_the_colour_scheme(elements):
    return meta_content(elements, "color-scheme") == ["light dark"]


# changes of a page that break a rule: what is replaced, and by what
RULES = [
    (the_language_is_said, 'lang="en"', ""),
    (it_takes_the_width_of_a_phone, "width=device-width", "width=1024"),
    (it_follows_the_colour_scheme, 'content="light dark"', 'content="light"'),
    (headings_skip_no_level, "</header>", "<h1>again</h1></header>"),
    (headings_skip_no_level, "<h2>", "<h2></h2><h4></h4><h2>"),
    (pictures_have_texts_of_their_own, ' alt="', ' alt="" title="'),
    (pictures_have_texts_of_their_own, "</main>", '<img alt="x"><img alt="x"></main>'),
    (every_table_header_has_a_text_and_a_scope, ' scope="row"', ""),
    (every_table_header_has_a_text_and_a_scope, "</main>", '<th scope="col"></th></main>'),
    (every_table_has_a_name, '<strong id="', '<strong class="'),
    (what_scrolls_can_be_reached_and_has_a_name, 'tabindex="0"', ""),
    (what_is_drawn_is_hidden, "</main>", '<span class="range ours"></span></main>'),
    (nothing_comes_from_outside, "</main>", '<img alt="x" src="//example.org/x.png"></main>'),
]
CHECKS = [
    {"name": "many steps beat one", "verdict": "fail", "says": "one 20 %, 20 10 %"},
    {"name": "gradients are not hidden", "verdict": "warning", "says": "0.1 %"},
    {"name": "every image gets an answer", "verdict": "pass", "says": "0 of 9"},
]


def run_page(folder, metrics, pictures):
    train = replace(metrics.train, images_per_second=25.0)
    metrics = replace(metrics, trust=CHECKS, trust_n=96, train=train)
    report.write_run(folder / "report.html", metrics, pictures)
    return (folder / "report.html").read_text("utf-8")


def suite_page(folder, metrics, pictures):
    tables, lines = [], []
    rows, columns = ["eps_4", "eps_8"], ["moire", "random", "ma"]
    for name in ("success", "standard"):
        tables.append(SimpleNamespace(name=name, rows=rows, columns=columns))
        for row in rows:
            for column in columns:
                lines.append({"table": name, "row": row, "column": column})
    frame = pd.DataFrame(lines).assign(
        condition="x", control=False, judge="model", eps=4 / 255, counted=9, n=10, undecided=0
    )
    frame = frame.assign(
        bound="codes", success=0.5, low=0.3, high=0.7, seconds=1.0, outcomes="", paper=0.4
    )
    frame = frame.assign(psnr=30.0, ssim=0.9, ciede2000=1.0, largest=0.1, lpips=0.2)
    frame = frame.assign(moire=4.1, moire_seen=0.9)
    shown = suite_metrics(suite="paper", trust=CHECKS, trust_n=9)
    report.write_suite(folder, shown, tables, frame, {"success": pictures})
    return (folder / "report.html").read_text("utf-8")


def demoireing_page(folder, metrics, pictures):
    history = [{"steps": 10.0 * i, "loss": 0.1, "psnr": 30.0, "photo_psnr": 28.0} for i in (1, 2)]
    tested = []
    for measure, before, after in (("psnr", 28.0, 30.0), ("ssim", 0.8, 0.9)):
        row = {"group": "screen_photo", "kind": "seen", "reference": "twin", "measure": measure}
        row |= {"before": before, "after": after, "gain": after - before, "gain_interval": None}
        row |= {"n": 4, "gained": 3, "twin": None, "milliseconds": 12.0, "megapixels": 0.1}
        tested.append(row)
    metrics = metrics.to_dict() | {"width": 0.25, "target": "twin", "test": tested}
    metrics["train"] = {"history": history, "best_steps": 20}
    picture = torch.zeros(3, 8, 8, dtype=torch.uint8)
    pair = GroupedPair("screen_photo", "seen", "a", picture, picture, picture)
    return demoireing.page(metrics, [(pair, picture)])


def calibration_page(folder, metrics, pictures):
    pixels = torch.zeros(1, 3, 8, 8, dtype=torch.uint8)
    crops = Crops(pixels, pixels, torch.zeros(1, dtype=torch.int64), ("a",))
    measures = [dict.fromkeys(STATISTICS, 1.0)]
    scene = Scene.preset("paper")
    fitted = FittedScene(scene, scene, 0.5, 0.4, 0.5, 0.3, 10, 2.0, (("panel.scale", 1.0, 2.0),))
    examples = calibrate.example_blocks(crops, pixels, "paper")
    found = compare_statistics(measures, measures)
    return calibrate.page(found, crops, scene, "paper", b"", examples, fitted)


PAGES = (run_page, suite_page, demoireing_page, calibration_page)


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    return {make.__name__: make(folder, run_metrics(), run_pictures()) for make in PAGES}


def test_every_page_keeps_every_rule(pages):
    for name, text in pages.items():
        elements = Elements(text)
        assert not [rule.__name__ for rule, *_ in RULES if not rule(elements)], name


def test_a_page_that_breaks_a_rule_is_found(pages):
    for rule, before, after in RULES:
        assert before in pages["run_page"], rule
        assert not rule(Elements(pages["run_page"].replace(before, after))), rule


def luminance(colour):
    """Relative luminance of #rgb or #rrggbb (WCAG 2.2)."""
    digits = colour[1:] if len(colour) == 7 else "".join(2 * digit for digit in colour[1:])
    linear = []
    for i in (0, 2, 4):
        value = int(digits[i : i + 2], 16) / 255
        linear.append(value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4)
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one, other):
    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def test_colours_stand_out_from_the_paper():
    style = page.environment().loader.get_source(page.environment(), "style.css")[0]
    schemes = [dict(re.findall(r"--(\w+): (#\w+);", part)) for part in style.split(":root {")[1:]]
    wanted = {"ink": 7, "soft": 4.5, "right": 4.5, "wrong": 4.5, "ours": 3, "theirs": 3}
    assert len(schemes) == 2  # light and dark
    for scheme in schemes:
        for colour, ratio in wanted.items():
            assert contrast(scheme[colour], scheme["paper"]) >= ratio, colour


def test_contrast_is_what_the_standard_says():
    assert contrast("#000", "#fff") == pytest.approx(21)
    assert contrast("#767676", "#ffffff") == pytest.approx(4.54, abs=0.01)


def test_settings_are_printed_a_line_each(pages):
    assert ">data:\n  name: signs\n  root: None\nempty: {}</pre>" in pages["run_page"]


def test_a_ratio_of_costs_keeps_its_digits(pages):
    cells = pages["run_page"].split("images per second</th>")[1].split("</tr>")[0]
    assert re.findall(r"<td>(.*?)</td>", cells) == ["100", "25", "0.25"]
