"""The frontier: its figures against closed forms, its refusals, and files that open."""

import csv
import io
import json
import math
import random
from pathlib import Path

import pytest
from PIL import Image
from scipy import stats

from moireaug import Scene
from moireaug.evaluation.suites.scenes import OWN, other_scenes
from training import frontier as command
from training.frontier_plot import draw, figure
from training.points import read
from training.summaries import pareto, rate, summarise

SCENE = Scene.preset("screen_photo")
ENVIRONMENT = {"device": "cpu", "cpu": "a slow one", "threads": 2}


def cell(row, column, accuracy, n):
    """A cell of which the first images are right."""
    right = round(accuracy * n)
    return {"row": row, "column": column, "outcomes": "1" * right + "0" * (n - right)}


def put(
    root,
    recipe,
    seed,
    *,
    worst=(0.2, 0.1),
    seconds=10.0,
    start=10.0,
    init="clean",
    unseen=0.6,
    attacked=True,
    n=200,
    steps=50,
    collapsed=None,
    scene="screen_photo",
    data="signs",
    at=None,
    size=48,
    device=ENVIRONMENT,
    trust=(),
):
    """A finished run as fit.py leaves it, and its re-attack."""
    folder = root / recipe / f"seed{seed}"
    init = "random" if recipe == "clean" else init
    where = Scene.preset(scene).to_dict()
    train = {
        "seconds": seconds,
        "images_per_second": 600.0,
        "init": init,
        "passes": 2.5,
        "collapsed_at": collapsed,
    }
    plain = {"recipe": "clean", "train": {"seconds": start}}
    started = init == "clean"
    baseline = (
        None
        if recipe in ("clean", "baseline")
        else {"recipe": "baseline", "train": {"seconds": 1.0}}
    )
    if baseline and not started:
        baseline = plain
    config = {
        "data": {"name": data, "size": size, "root": at},
        "reattack": {"n": 480, "steps": 20, "seed": 1234},
    }
    metrics = {
        "recipe": recipe,
        "seed": seed,
        "data": data,
        "model": "small_resnet",
        "train": train,
        "config": config,
        "baseline": baseline,
        "start": plain if started else None,
        "scene_name": scene,
        "scene": where,
        "environment": device,
    }
    write(folder, metrics)
    if attacked:
        rows = [cell(f"eps_{e}", "worst", w, n) for e, w in zip((4, 8), worst, strict=True)]
        rows += [
            cell("eps_4", "clean", 0.9, n),
            cell("eps_4", "pgd", 0.4, n),
            cell("eps_4", "moire", 0.7, n),
        ]
        photos = [cell(OWN, "moire", 0.7, n), cell(OWN, "no_moire", 0.8, n)]
        photos += [
            cell(name, "moire", unseen + 0.1 * i, n) for i, name in enumerate(other_scenes(SCENE))
        ]
        again = {"n": n, "steps": steps, "scene": where, "config": config, "trust": list(trust),
                 "tables": {"worst_case": rows, "unseen": photos}}  # fmt: skip
        write(folder / "reattack" / f"{scene}-n{n}-steps{steps}" / "recipes", again)
    return folder


def write(folder, metrics):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "metrics.json").write_text(json.dumps(metrics))


@pytest.fixture
def root(tmp_path):
    """Three recipes of three seeds; `slow` is beaten by `good`, and `lone` has one seed."""
    for seed in range(3):
        put(tmp_path, "clean", seed, worst=(0.01, 0.0), seconds=10.0 + seed)
        put(tmp_path, "good", seed, worst=(0.3 + 0.02 * seed, 0.2), seconds=20.0, start=10.0 + seed)
        put(
            tmp_path, "slow", seed, worst=(0.2, 0.1), seconds=60.0, start=10.0 + seed, init="random"
        )
    put(tmp_path, "lone", 0, worst=(0.5, 0.25), seconds=100.0, collapsed=4)
    return tmp_path


def test_the_figures_of_the_table(root):
    recipes = {r.name: r for r in command.frontier(root, root / "out")}
    assert list(recipes) == ["clean", "good", "slow", "lone"]  # the cheapest first
    good, slow, lone = recipes["good"], recipes["slow"], recipes["lone"]
    assert good.seeds == (0, 1, 2) and good.rates["worst_4"].value == pytest.approx(0.32)
    assert [good.rates[key].value for key in ("clean", "natural", "pgd_4")] == pytest.approx(
        [0.9, 0.7, 0.4]
    )
    assert (
        good.rates["unseen_mean"].value == pytest.approx(0.7)
        and good.rates["unseen_worst"].value == 0.6
    )
    assert recipes["clean"].relative.value == 1 and recipes["clean"].start_seconds == 0
    assert good.relative.value == pytest.approx((20 + 11) / 11) and good.start_seconds == 11
    assert (
        slow.relative.value == pytest.approx(60 / 11) and slow.start_seconds == 0
    )  # it began with random weights
    assert [r.name for r in recipes.values() if r.front] == ["clean", "good", "lone"]
    assert lone.collapsed == 1 and lone.relative.low == lone.relative.high == lone.relative.value


def test_intervals_hold_seeds_and_images(root):
    points = read(root).points
    lone = [point for point in points if point.recipe == "lone"]
    one = stats.binomtest(100, 200).proportion_ci(0.95, method="wilson")
    assert rate(lone, "worst_4") == pytest.approx((0.5, one.low, one.high), abs=1e-6)
    good = [point for point in points if point.recipe == "good"]
    value, low, high = rate(good, "worst_4")
    alone = stats.binomtest(64, 200).proportion_ci(0.95, method="wilson")
    assert value == pytest.approx(0.32) and low < value < high
    # as wide as that of the images alone, and more: three seeds on the same images are not six
    # hundred
    assert high - low > 0.95 * (alone.high - alone.low)
    clean = [point for point in points if point.recipe == "clean"]
    assert rate(clean, "worst_8").low == 0  # no accuracy is below 0
    shared = {k: 1 for k in ("n", "data", "model", "scene", "steps")}
    words = command.caption(summarise(points), shared)
    assert "hold the choice of seeds and of images" in words and "lone in 1 of 1 seeds" in words


def test_gains_are_over_plain_training_of_equal_length(tmp_path):
    for seed in range(3):
        put(tmp_path, "clean", seed, worst=(0.0, 0.0))
        put(tmp_path, "baseline", seed, worst=(0.1 + 0.05 * seed, 0.0))
        put(tmp_path, "good", seed, worst=(0.3 + 0.05 * seed, 0.2))
        put(tmp_path, "scratch", seed, worst=(0.4, 0.2), init="random")
    put(tmp_path, "good", 7, worst=(1.0, 1.0))  # no baseline of its seed
    found = read(tmp_path)
    recipes = {r.name: r for r in summarise(found.points)}
    assert recipes["clean"].gains == recipes["baseline"].gains == {}
    gain = recipes["good"].gains["worst_4"]
    # the same images are right in each pair, so that the difference is the same for every seed
    assert gain.value == pytest.approx(0.2) and gain.low <= 0.2 <= gain.high and gain.low > 0.1
    assert recipes["scratch"].gains["worst_4"].value == pytest.approx(
        0.4
    )  # over clean, which is as long
    text = command.markdown(list(recipes.values()), found)
    assert (
        "Gain over plain training of as many epochs" in text
        and "| good" in text
        and "+20.0" in text
    )


def test_the_front_is_what_nothing_dominates():
    dice = random.Random(0)
    for _ in range(200):
        points = [(dice.randint(1, 6), dice.randint(1, 6)) for _ in range(dice.randint(1, 9))]
        kept = []
        for cost, gain in points:
            better = [
                (c, g) for c, g in points if c <= cost and g >= gain and (c < cost or g > gain)
            ]
            kept.append(not better)
        assert pareto(points) == kept and any(kept)


def test_every_file_is_whole(root, capsys):
    command.main([str(root)])
    out = root / "frontier"
    assert {p.name for p in out.iterdir()} == {
        "frontier.md",
        "frontier.csv",
        "frontier.json",
        "frontier.png",
    }
    lines = list(csv.DictReader(io.StringIO((out / "frontier.csv").read_text())))
    assert len(lines) == 10 and {line["recipe"] for line in lines} == {
        "clean",
        "good",
        "slow",
        "lone",
    }
    assert all(
        math.isclose(float(x["total_seconds"]), float(x["seconds"]) + float(x["start_seconds"]))
        for x in lines
    )
    whole = json.loads((out / "frontier.json").read_text())
    assert whole["recipes"][1]["rates"]["worst_4"]["value"] == pytest.approx(0.32)
    assert whole["shared"] == {
        "data": "signs",
        "model": "small_resnet",
        "scene": "screen_photo",
        "n": 200,
        "steps": 50,
        "seed": 1234,
        "batch_size": None,
    }
    words = (out / "frontier.md").read_text()
    assert (
        "| good ● | 3 |" in words
        and "| slow | 3 |" in words
        and "| lone ● † | 1 |" in words
        and "nan" not in words
    )
    tables = [part for part in words.split("\n\n") if part.startswith("|")]
    assert len(tables) == 2
    for table in tables:
        assert len({line.count("|") for line in table.splitlines()}) == 1
    with Image.open(out / "frontier.png") as image:
        image.load()
        assert image.size == (1000, 490)
    printed = capsys.readouterr().out
    assert (
        "× clean" in printed and max(map(len, printed.split("\nAccuracy")[0].splitlines())) <= 100
    )


def named(fig):
    """The names in each panel, as boxes in pixels, and the panel."""
    fig.canvas.draw()
    for ax in fig.axes:
        yield [t.get_window_extent() for t in ax.texts], ax.get_window_extent()


def test_names_are_whole_and_apart(tmp_path):
    for i, recipe in enumerate(
        ("clean", "moire_aug", "moire_at", "a_long_name_of_a_recipe", "pgd", "b", "cc", "d", "e")
    ):
        for seed in range(3):
            put(
                tmp_path,
                recipe,
                seed,
                worst=(0.05 * i + 0.01 * seed, 0.03 * i),
                seconds=10.0 + 3 * i + 0.1 * seed,
            )
    found = read(tmp_path)
    for boxes, panel in named(figure(summarise(found.points), found.shared)):
        assert len(boxes) == 9
        for i, box in enumerate(boxes):
            assert not box.count_overlaps(boxes[i + 1 :])
            assert (
                panel.x0 <= box.x0
                and box.x1 <= panel.x1
                and panel.y0 <= box.y0
                and box.y1 <= panel.y1
            )


def test_hard_cases_are_drawn(tmp_path):
    put(tmp_path, "clean", 0, worst=(0.0, 0.0))
    found = read(tmp_path)
    assert draw(summarise(found.points), found.shared)  # a point alone
    for seed, seconds in enumerate((1.0, 900.0)):  # an interval of time that reaches below 0
        put(tmp_path, r"$\\broken_$ré", seed, worst=(0.0, 1.0), seconds=seconds)
    recipes = summarise(read(tmp_path).points)
    assert recipes[-1].relative.low == 0 and draw(recipes, found.shared | {"scene": "$"})


def test_a_run_that_was_not_attacked_is_left_out_with_its_command(root, tmp_path):
    put(root, "new one", 0, attacked=False)
    (
        root / "good" / "seed0-0123456789ab"
    ).mkdir()  # set aside by fit.py, which found other settings there
    write(root / "good" / "seed0-0123456789ab", {"train": None})
    found = read(root)
    assert len(found.points) == 10
    assert found.commands == [
        f"python training/reattack.py run='{root}/new one/seed0' suite=recipes reattack.n=200 "
        f"reattack.steps=50"
    ]
    recipes = command.frontier(root, root / "out")
    assert (
        "new one" not in {r.name for r in recipes}
        and "    python training/" in (root / "out/frontier.md").read_text()
    )


def test_an_attack_in_another_scene_does_not_count(tmp_path):
    folder = put(tmp_path, "good", 0)
    (folder / "reattack/screen_photo-n200-steps50").rename(folder / "reattack/elsewhere")
    assert len(read(tmp_path).points) == 1  # whatever its folder is called
    path = folder / "reattack/elsewhere/recipes/metrics.json"
    again = json.loads(path.read_text())
    path.write_text(json.dumps(again | {"scene": Scene.preset("phone_at_laptop").to_dict()}))
    with pytest.raises(
        ValueError,
        match=r"(?s)own scene. Run:.*run=\S+/good/seed0 suite=recipes reattack.steps=50$",
    ):
        read(tmp_path)


def test_an_attack_on_other_images_does_not_count(tmp_path):
    """However many they are."""
    folder = put(tmp_path, "good", 0)
    path = next(folder.glob("reattack/*/recipes/metrics.json"))
    again = json.loads(path.read_text())
    again["config"] = again["config"] | {"data": {"name": "folder", "size": 48, "root": "other"}}
    cells = [line | {"outcomes": "0" * 1000} for line in again["tables"]["worst_case"]]
    again |= {"n": 1000, "tables": again["tables"] | {"worst_case": cells}}
    write(folder / "reattack/other-n1000/recipes", again)
    (point,) = read(tmp_path).points
    assert point.outcomes["clean"].mean() == 0.9


@pytest.mark.parametrize(
    ("odd", "message"),
    [
        (
            {"data": "cifar10"},
            r"runs with different data.name do not compare: \S+odd/seed0 has 'cifar10', most "
            r"others",
        ),
        (
            {"size": 32},
            "runs with different data.size do not compare: .* has 32, most others have 48",
        ),
        (
            {"scene": "phone_at_laptop"},
            "different scene do not compare: .*'phone_at_laptop', .* have 'screen_photo'",
        ),
        (
            {"steps": 20},
            "re-attacks with different reattack.steps do not compare: .* has 20, most others "
            "have 50",
        ),
        ({"n": 480}, r"re-attacks with different reattack.n do not compare: \S+odd/seed0 has 480"),
    ],
)
def test_what_does_not_compare_is_named(root, odd, message):
    put(root, "odd", 0, **odd)
    with pytest.raises(ValueError, match=message):
        read(root)


def test_mistakes_get_a_sentence(tmp_path):
    with pytest.raises(
        SystemExit,
        match=r"error: no finished run in \S+: it must hold <recipe>/seed<k>/metrics.json",
    ):
        command.main([str(tmp_path / "nowhere")])
    for argv in ([], ["a", "b"], ["a", "out=b", "out=c"]):
        with pytest.raises(SystemExit, match="error: pass one folder of runs, as in: python"):
            command.main(argv)
    folder = put(tmp_path, "good", 0)
    metrics = json.loads((folder / "metrics.json").read_text())
    write(folder, metrics | {"baseline": None, "start": None})
    with pytest.raises(ValueError, match="train recipe clean with seed=0 and the same settings"):
        read(tmp_path)
    del metrics["train"]["passes"]
    write(folder, metrics)
    with pytest.raises(ValueError, match="lacks 'passes': another version"):
        read(tmp_path)


def test_a_folder_of_images_goes_by_its_own_name(tmp_path):
    put(tmp_path, "clean", 0, data="folder", at="somewhere/gtsrb")
    put(tmp_path, "good", 0, data="folder", at="elsewhere/gtsrb/")
    assert read(tmp_path).shared["data"] == "gtsrb"
    put(tmp_path, "good", 1, data="folder", at="elsewhere/moved")
    assert read(tmp_path).shared["data"] == "folder"


def test_times_of_two_machines_and_failed_checks_are_said(tmp_path):
    failed = {"name": "many steps beat one", "verdict": "fail", "says": ""}
    put(tmp_path, "clean", 0, trust=[failed, failed | {"verdict": "pass", "name": "fine"}])
    put(tmp_path, "good", 0, device={"device": "NVIDIA H100"})
    machines, checks = read(tmp_path).warnings
    assert machines.startswith(
        "The runs were trained on different machines (NVIDIA H100; a slow one, 2 threads)"
    )
    assert checks.endswith(f"failed on {Path(tmp_path, 'clean', 'seed0')}: many steps beat one.")
