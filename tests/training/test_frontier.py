"""The frontier: its figures against closed forms, its refusals, and files that open."""

import csv
import io
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image
from scipy import stats

from tests.training import frontier_runs
from tests.training.frontier_runs import put
from training import frontier as command
from training.comparison.csv_file import to_csv
from training.comparison.frame import read
from training.comparison.plot import draw, figure
from training.comparison.summaries import estimate_rate, pareto, summarise
from training.comparison.table import caption, markdown


def test_the_figures_of_the_table(root):
    recipes = {r.name: r for r in command.frontier(root, root / "out")}
    assert list(recipes) == ["clean", "good", "slow", "lone"]  # the cheapest first
    good, slow, lone = recipes["good"], recipes["slow"], recipes["lone"]
    assert good.seeds == (0, 1, 2) and good.rates["worst_4"].value == pytest.approx(0.32)
    rates = [good.rates[key].value for key in ("clean", "natural", "pgd_4")]
    assert rates == pytest.approx([0.9, 0.7, 0.4])
    assert good.rates["unseen_mean"].value == pytest.approx(0.7, abs=0.01)
    assert good.rates["unseen_worst"].value == 0.6
    # the mean of those that know it: 20 after a start of 10, 11 and 12, alone, and after one of 10
    plain = (30 + 31 + 32 + 3 * 20 + 30) / 7
    assert recipes["clean"].relative_time.value == pytest.approx(11 / plain)
    assert recipes["clean"].costs["start_seconds"] == 0
    assert good.relative_time == pytest.approx((1, 1, 1)) and good.costs["start_seconds"] == 11
    assert slow.relative_time.value == pytest.approx(60 / 20)
    assert slow.costs["start_seconds"] == 0  # it began with random weights
    assert [r.name for r in recipes.values() if r.is_on_front] == ["clean", "good", "lone"]
    value, low, high = lone.relative_time
    assert lone.collapsed_count == 1 and low == high == value


def test_intervals_hold_seeds_and_images(root):
    runs = read(root).runs
    by_recipe = runs.set_index("recipe")
    one = stats.binomtest(100, 200).proportion_ci(0.95, method="wilson")
    lone = estimate_rate(by_recipe.loc[["lone"], "worst_4"])
    assert lone == pytest.approx((0.5, one.low, one.high), abs=1e-6)
    value, low, high = estimate_rate(by_recipe.loc["good", "worst_4"])
    alone = stats.binomtest(64, 200).proportion_ci(0.95, method="wilson")
    assert value == pytest.approx(0.32) and low < value < high
    # as wide as that of the images alone, and more: three seeds on the same images are not six
    # hundred
    assert high - low > 0.95 * (alone.high - alone.low)
    assert estimate_rate(by_recipe.loc["clean", "worst_8"]).low == 0  # no accuracy is below 0
    words = caption(summarise(runs), read(root))
    assert "cover the choice of seeds and of images" in words and "lone in 1 of 1 seeds" in words


def test_gains_are_over_plain_training_of_as_many_epochs(tmp_path):
    for seed in range(3):
        put(tmp_path, "clean", seed, worst=(0.0, 0.0))
        put(tmp_path, "baseline", seed, worst=(0.1 + 0.05 * seed, 0.0))
        put(tmp_path, "good", seed, worst=(0.3 + 0.05 * seed, 0.2))
        put(tmp_path, "scratch", seed, worst=(0.4, 0.2), init="random")
    put(tmp_path, "good", 7, worst=(1.0, 1.0))  # no baseline of its seed
    found = read(tmp_path)
    recipes = {r.name: r for r in summarise(found.runs)}
    assert recipes["clean"].gains == recipes["baseline"].gains == {}
    gain = recipes["good"].gains["worst_4"]
    # the same images are right in each pair, so that the difference is the same for every seed
    assert gain.value == pytest.approx(0.2) and gain.low <= 0.2 <= gain.high and gain.low > 0.1
    assert not recipes["scratch"].gains  # its start is not that of baseline
    text = markdown(list(recipes.values()), found, "baseline")
    for words in ("Gain over plain training of at least as many epochs", "| good", "+20.0"):
        assert words in text


def test_gains_over_another_recipe(tmp_path, capsys):
    for seed in range(3):
        put(tmp_path, "baseline", seed, worst=(0.1, 0.0))
        put(tmp_path, "rival", seed, worst=(0.2 + 0.05 * seed, 0.2))
        put(tmp_path, "good", seed, worst=(0.3 + 0.05 * seed, 0.2))
    command.main([str(tmp_path), "against=rival"])
    recipes = {r.name: r for r in summarise(read(tmp_path).runs, "rival")}
    assert recipes["baseline"].gains == recipes["rival"].gains == {}
    assert recipes["good"].gains["worst_4"].value == pytest.approx(0.1)
    for text in (capsys.readouterr().out, (tmp_path / "frontier/frontier.md").read_text()):
        assert "over rival, in points" in text and "+10.0" in text
    with pytest.raises(SystemExit, match="against must be one of 'baseline', 'good', 'rival'"):
        command.main([str(tmp_path), "against=best"])


def test_runs_compared_with_a_network_that_was_not_trained_get_a_sentence(tmp_path):
    for seed in range(2):
        folder = put(tmp_path, "moire_tune", seed, worst=(0.3, 0.2))
        metrics = frontier_runs.metrics_in(folder)
        metrics["baseline"] |= {"recipe": "original", "train": None}
        frontier_runs.write(folder, metrics)
    with pytest.raises(SystemExit, match="no run says how long plain training takes"):
        command.main([str(tmp_path)])


def test_the_front_is_what_nothing_dominates():
    points = [(1, 0), (2, 3), (2, 2), (3, 3), (4, 5), (4, 5), (1, -1)]
    assert pareto(points) == [True, True, False, False, True, True, False] and pareto([]) == []


def test_every_file_is_whole(root, capsys):
    for seed in range(3):
        put(root, "baseline", seed, seconds=30.0, start=10.0 + seed)
    command.main([str(root)])
    out = root / "frontier"
    assert {p.suffix for p in out.iterdir()} == {".md", ".csv", ".png"}
    lines = list(csv.DictReader(io.StringIO((out / "frontier.csv").read_text())))
    names = {"clean", "baseline", "good", "slow", "lone"}
    assert len(lines) == 13 and {line["recipe"] for line in lines} == names
    for x in lines:
        parts = float(x["seconds"]) + float(x["start_seconds"])
        assert float(x["total_seconds"]) == pytest.approx(parts)
    words = (out / "frontier.md").read_text()
    assert "nan" not in words
    for row in ("| good ● | 3 |", "| slow | 3 |", "| lone ● † | 1 |"):
        assert row in words
    tables = [part for part in words.split("\n\n") if part.startswith("|")]
    assert len(tables) == 2
    for table in tables:
        assert len({line.count("|") for line in table.splitlines()}) == 1
    with Image.open(out / "frontier.png") as image:
        image.load()
        assert image.size == (640, 740)
    printed = capsys.readouterr().out.split("\nAccuracy")[0]
    assert max(map(len, printed.splitlines())) <= 100


def test_a_table_of_csv_has_the_same_figures(tmp_path):
    """Intervals, too: the outcome of each image is in it."""
    for recipe, worst in (("baseline", 0.0), ("good", 0.3)):
        for seed in range(3):
            put(tmp_path, recipe, seed, worst=(worst + 0.02 * seed, worst), seconds=20.0 + seed)
    of_runs = command.frontier(tmp_path, tmp_path / "out")
    of_csv = command.frontier(tmp_path / "out/frontier.csv", tmp_path / "again")
    first, second = ((tmp_path / name / "frontier.csv").read_text() for name in ("out", "again"))
    assert first == second
    assert of_runs == of_csv


def test_a_csv_that_is_not_there_is_not_to_be_resumed(tmp_path):
    with pytest.raises(SystemExit, match=r"none.csv is no frontier.csv .*No such file") as error:
        command.main([str(tmp_path / "none.csv"), f"out={tmp_path}"])
    assert "resume" not in str(error.value)


def test_a_csv_that_is_no_table_gets_a_sentence(root, tmp_path):
    lines = to_csv(read(root)).splitlines()
    for text, said in (
        ("", "is no frontier.csv"),
        ("recipe,seed\ngood,0\n", "is no frontier.csv .*lacks baseline, bound, clean"),
        ("\n".join(lines).replace("total_seconds", "seconds_in_all"), "lacks total_seconds"),
        ("\n".join(lines).replace(",0.9,", ",,"), r"clean must be at least 0; got \[nan"),
        ("\n".join(lines).replace(",0.9,", ",inf,"), r"clean must be at least 0; got \[inf"),
        ("\n".join(lines).replace(",0.9,", ",x,"), "is no frontier.csv .*'x'"),
        ("\n".join(lines).replace("good,", ","), "a line names no recipe"),
        ("\n".join([*lines, lines[0]]), "the head of another table is among its lines"),
        ("\n".join(lines).replace(",0.9,", ",0.8,"), "clean is 0.8, but the mean .* 0.9"),
        ("\n".join(lines).replace("1 1 0", "1 0"), "must be 200 numbers between 0 and 1"),
        ("\n".join(lines).replace("1 1 0", "1 9 0"), "must be 200 numbers between 0 and 1"),
        ("\n".join(lines).replace("1 1 0", "1 x 0"), "is no frontier.csv .*'x'"),
        ("\n".join(line.rpartition(",")[0] for line in lines), "lacks pgd_4_outcomes"),
        ("\n".join([*lines[:4], lines[4].replace(",50", ",20")]), "runs of different steps"),
        (
            "\n".join([*lines[:4], lines[4].replace(",signs,0", ",signs,1")]),
            "of different data_seed",
        ),
        (
            "\n".join([*lines[:4], lines[4].replace(",codes,1234", ",codes,7")]),
            "of different reattack_seed",
        ),
        ("\n".join(lines).replace(",30.0,2.5", ",0.0,2.5"), "plain_seconds must be above 0"),
    ):
        (tmp_path / "table.csv").write_text(text)
        with pytest.raises(SystemExit, match=f"error: .*{said}"):
            command.main([str(tmp_path / "table.csv"), f"out={tmp_path / 'out'}"])
        assert not (tmp_path / "out").exists()
    with pytest.raises(SystemExit, match="error: say where to write the table of a CSV"):
        command.main([str(tmp_path / "table.csv")])


def test_a_seed_given_twice_does_not_narrow_the_intervals(tmp_path):
    for recipe in ("baseline", "good"):
        for seed in range(2):
            put(tmp_path, recipe, seed, worst=(0.3 + 0.1 * seed, 0.1))
    head, *lines = to_csv(read(tmp_path)).splitlines()
    (tmp_path / "joined.csv").write_text("\n".join([head, *lines, *lines]))
    with pytest.raises(SystemExit, match="has baseline, seed 0, more than once"):
        command.main([str(tmp_path / "joined.csv"), f"out={tmp_path / 'out'}"])


def test_a_single_number_has_no_gain(tmp_path):
    """A shared seed of two tables, or a single image: no interval follows from it."""
    for recipe, seeds in (("baseline", (0, 1)), ("good", (1, 2))):
        for seed in seeds:
            put(tmp_path / "runs", recipe, seed, n=1)
    recipes = command.frontier(tmp_path / "runs", tmp_path / "out")
    assert [recipe.gains for recipe in recipes] == [{}, {}]
    recipes = command.frontier(tmp_path / "out/frontier.csv", tmp_path / "again")
    assert [recipe.gains for recipe in recipes] == [{}, {}]


def test_names_are_whole_and_apart(tmp_path):
    costs = {"moire_aug": 14.0, "moire_fast": 18.0, "pgd_at": 24.0, "moire_at": 40.0}
    for recipe, worst in zip(("clean", *costs), (0.0, 0.0, 0.4, 0.1, 0.5), strict=True):
        for seed in range(3):
            put(tmp_path, recipe, seed, worst=(worst, worst / 2), seconds=costs.get(recipe, 10.0))
    found = read(tmp_path)
    fig = figure(summarise(found.runs), found.shared)
    fig.draw_without_rendering()
    for ax in fig.axes:
        panel, boxes = ax.get_window_extent(), [text.get_window_extent() for text in ax.texts]
        assert len(boxes) == 5
        for i, box in enumerate(boxes):
            assert not box.count_overlaps(boxes[i + 1 :])
            assert panel.x0 <= box.x0 and box.x1 <= panel.x1
            assert panel.y0 <= box.y0 and box.y1 <= panel.y1


def test_hard_cases_are_drawn(tmp_path):
    put(tmp_path, "good", 0, worst=(0.0, 0.0))
    found = read(tmp_path)
    assert draw(summarise(found.runs), found.shared)  # a point alone
    alone = tmp_path / "alone"
    put(alone, "clean", 0, attacked=False)
    put(alone, "moire_at", 0, seconds=34.0)  # between two of the usual ticks
    (recipe,) = recipes = summarise(read(alone).runs)
    ax = figure(recipes, found.shared).axes[0]
    left, right = ax.get_xlim()
    assert recipe.relative_time.value == pytest.approx(44 / 30)
    assert sum(left <= tick <= right for tick in ax.get_xticks()) > 1
    for seed, seconds in enumerate((1.0, 900.0)):  # an interval of time that reaches below 0
        put(tmp_path, r"$\\broken_$ré", seed, worst=(0.0, 1.0), seconds=seconds)
    recipes = summarise(read(tmp_path).runs)
    assert recipes[-1].relative_time.low == 0 and draw(recipes, found.shared | {"scene": "$"})


def test_a_collapse_costs_the_epochs_of_more_steps():
    history = [{"seconds": s} for s in (1.0, 1.0, 9.0, 3.0, 3.0)]
    train = replace(frontier_runs.cost(17.0, "clean"), history=history)
    assert train.steady_seconds == 15.0  # the median of all is 3
    assert replace(train, collapsed_at=2).steady_seconds == 9.0  # 3 of 1, and 2 of 3
    assert replace(train, collapsed_at=4).steady_seconds == 15.0


@pytest.mark.parametrize("name", ["signs", "gtsrb", "cifar10"])
def test_published_intervals_follow_from_the_published_rows(name, tmp_path):
    published = Path(__file__).parents[2] / f"benchmarks/results/frontier-{name}.csv"
    recipes = command.frontier(published, tmp_path, "pgd_at")
    page = "frontier_signs" if name == "signs" else "other_data"
    text = (published.parents[2] / f"docs/appendix/{page}.md").read_text()
    for recipe in recipes:
        value, low, high = (100 * x for x in recipe.rates["worst_4"])
        assert f"{value:.1f} <sub>{low:.1f}–{high:.1f}</sub>" in text
