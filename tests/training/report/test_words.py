"""What a report says in words: its headline, the table for the terminal, durations."""

import re
from dataclasses import replace

import pytest

from moireaug.evaluation import SuiteConfig, tables_of
from training import report
from training.report import run_parts
from training.report.numbers import duration, moire_text, points, tied
from training.report.page import environment, title_of
from training.report.run_view import run_view


def headline(metrics):
    """(title, lead, shares)."""
    said = environment().get_template("headline.j2").module
    run = run_view(metrics)
    return said.title(run), said.lead(run), said.shares(run)


def test_headline_says_what_was_gained_and_paid(metrics):
    title, lead, shares = headline(metrics)
    assert title == "moire_at raises accuracy under the Moiré Attack from 8 % to 76 %"
    assert "rose from 8 % to 76 % (+68 points, 95 % interval +62 to +74, n = 200)" in lead
    assert "clean accuracy went from 95.0 % to 90.0 %." in lead
    assert "4 min 30 s with its start, 2.1 times the 2 min 10 s of the baseline." in lead
    assert re.findall(r"[+]?\d+", shares) == ["20", "+26", "+46", "2", "+1", "+15"]


@pytest.mark.parametrize("threads", [2, 4])
def test_times_on_two_machines_are_told_apart(metrics, threads):
    baseline = replace(metrics.baseline, environment={"threads": threads})
    metrics = replace(metrics, baseline=baseline)
    for text in (headline(metrics)[1], "\n".join(run_parts(metrics))):
        assert (", on another machine" in text) == (threads != 2)


def test_headline_of_a_loss(metrics):
    ends = {name: [-high, -low] for name, (low, high) in metrics.gain_interval.items()}
    gains = {name: -gain for name, gain in metrics.gain.items()}
    ours, theirs = metrics.reattack, metrics.baseline
    swapped = replace(metrics, reattack=theirs.reattack, baseline=replace(theirs, reattack=ours))
    title, lead, _ = headline(replace(swapped, gain=gains, gain_interval=ends))
    assert title == "moire_at lowers accuracy under the Moiré Attack from 76 % to 8 %"
    assert "fell from 76 % to 8 % (−68 points, 95 % interval −74 to −62" in lead


def test_images_without_an_answer_are_told(metrics):
    metrics.reattack[0]["undecided"] = 3
    last = "\n".join(report.run_parts(metrics)).splitlines()[-1]
    assert "NaN or infinite" in last and "3 of 200 (moire_at, clean image)" in last


def test_how_much_moire_photos_have_is_told(metrics, tmp_path):
    before = "\n".join(report.run_parts(metrics))
    metrics.reattack[2] |= {"moire": 7.123, "moire_seen": 0.943}
    told = "moiré, photo minus the same without: median 7.1 codes RMS, 94 % of photos above 2"
    lines = "\n".join(report.run_parts(metrics)).splitlines()
    assert told in lines and "moiré, photo" not in before
    report.write_run(tmp_path / "report.html", metrics, [])
    assert "median 7.1 codes RMS" in (tmp_path / "report.html").read_text("utf-8")
    cells = [{"moire": moire, "moire_seen": seen} for moire, seen in ((0.04, 0.0), (12.0, 1.0))]
    assert moire_text([*cells, {"moire": None}, {}]).startswith("median 0.04 to 12 codes RMS, 0 to")
    assert moire_text([{}]) == ""
    crops = replace(metrics, scene_name=f"{'dashcam_at_led_sign, ' * 2}, shrink 1 to 3")
    assert ", dashcam_at_led_si…, shrink 1 to 3, n = 200" in "\n".join(report.run_parts(crops))


@pytest.mark.parametrize("interval", [[-0.01, 0.05], [0.0, 0.04], [-0.03, 0.0]])
def test_headline_of_a_difference_that_may_be_none(metrics, interval):
    metrics.gain["ma_4"], metrics.gain_interval["ma_4"] = 0.02, interval
    title, lead, _ = headline(metrics)
    assert "does not measurably change" in title
    assert "cannot tell from none" in lead and "rose" not in lead and "fell" not in lead


def test_headline_without_a_baseline(alone):
    title, lead, _ = headline(alone)
    assert title == "Accuracy under the Moiré Attack of moire_at: 76 %"
    assert lead.startswith(
        "The Moiré Attack at 4/255 in codes fools moire_at on 18 % of the images that"
    )


def test_headline_is_about_the_row_that_says_so_else_the_last(metrics):
    assert run_view(metrics)["main"]["name"] == "ma_4"
    for row in metrics.reattack:
        del row["headline"]  # as in metrics of an older version
    assert "accuracy under “PGD on pixels 4/255”" in headline(metrics)[0]


@pytest.mark.parametrize("has_baseline", [True, False])
def test_summary_is_an_aligned_table_of_at_most_100_columns(metrics, alone, has_baseline):
    shown = metrics if has_baseline else alone
    shown = replace(shown, **dict.fromkeys(("data", "model", "scene_name", "recipe"), "x" * 80))
    lines = "\n".join(report.run_parts(shown)).splitlines()
    assert max(map(len, lines)) <= 100
    assert len({len(line) for line in lines[1 : 2 + len(shown.reattack)]}) == 1
    assert "n = 200" in lines[0]
    assert lines[-1].startswith("training: ")
    assert "4 min 30 s" in lines[-1]
    assert ("+68.0 [+62.0, +74.0]" in "\n".join(lines)) == has_baseline
    assert ("  baseline  " in lines[1]) == has_baseline


def test_titles():
    assert title_of("moire", "columns") == "photo alone"  # by its name
    assert title_of("roll_15", "rows") == "roll 15°"  # by a pattern
    assert title_of("phone_at_laptop", "rows") == "phone_at_laptop"  # by none


def test_every_attacker_of_the_standard_suite_has_a_title():
    (table,) = tables_of("standard", SuiteConfig(scene="screen_photo"))
    untitled = [name for name in table.columns if title_of(name, "columns") == name]
    assert set(untitled) <= {"clean"}


def test_numbers_are_tied_to_their_units():
    space = "\N{NO-BREAK SPACE}"
    assert tied("8 % of n = 200, +3 points in 4 min") == (
        f"8{space}% of n{space}={space}200, +3{space}points in 4{space}min"
    )


def test_numbers_are_printed_as_people_say_them():
    shares = [points(value) for value in (0.123, -0.004, 0.0001, None, float("nan"))]
    assert shares == ["+12.3", "−0.4", "0.0", "–", "–"]
    times = [duration(value) for value in (None, 0.04, 59.94, 59.97, 210.3, 3900)]
    assert times == ["–", "0.0 s", "59.9 s", "1 min 0 s", "3 min 30 s", "1 h 5 min"]
