"""What a report says in words: its headline, the table for the terminal, durations."""

import pytest

from moireaug.evaluation import report
from moireaug.evaluation.words import duration, headline, main_row


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


@pytest.mark.parametrize("baseline", [True, False])
def test_summary_is_an_aligned_table_of_at_most_100_columns(metrics, baseline):
    metrics["recipe"] = "a_recipe_with_a_very_long_name"
    metrics["data"] = metrics["model"] = metrics["scene_name"] = "x" * 80
    metrics["reattack"][0]["title"] = "t" * 80
    if not baseline:
        metrics["baseline"] = None
    lines = report.summary(metrics).splitlines()
    assert max(map(len, lines)) <= 100
    assert len({len(line) for line in lines[1 : 2 + len(metrics["reattack"])]}) == 1
    assert "n = 200" in lines[0] and lines[-1].startswith("training: ") and "3 min 30 s" in lines[-1]
    assert ("+68.0  [+62.0, +74.0]" in "\n".join(lines)) == baseline


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(None, "–"), (0.04, "0.0 s"), (59.94, "59.9 s"), (59.97, "1 min 0 s"), (210.3, "3 min 30 s"), (3900, "1 h 5 min")],
)
def test_duration(seconds, said):
    assert duration(seconds) == said
