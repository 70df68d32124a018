"""Runs as the frontier reads them: which count, which can be compared, and what is said of the
others."""

import shutil

import pytest

from moireaug import Scene
from tests.training.frontier_runs import attack_of, cell, metrics_in, put, write
from training import frontier as command
from training.comparison.frame import read
from training.comparison.summaries import summarise


def test_a_run_without_attack_is_left_out_with_its_command(root):
    put(root, "new one", 0, attacked=False)
    write(root / "good/seed0-0123456789ab", {"train": None})  # set aside by fit.py
    found = read(root)
    assert len(found.runs) == 10
    assert found.commands == [
        f"python training/reattack.py run='{root}/new one/seed0' suite=recipes reattack.n=200 "
        f"reattack.steps=50"
    ]
    recipes = command.frontier(root, root / "out")
    assert "new one" not in {r.name for r in recipes}
    assert "    python training/" in (root / "out/frontier.md").read_text()


def test_the_command_states_what_a_suite_does_not_take_from_the_run(tmp_path):
    """The size of the ladder that a run ends with is not that of its other suites."""
    folder = put(tmp_path, "good", 0, attacked=False)
    metrics = metrics_in(folder)
    metrics["config"]["reattack"] |= {"n": 100, "steps": 50}
    write(folder, metrics)
    with pytest.raises(ValueError, match=r"suite=recipes reattack\.steps=50$"):
        read(tmp_path)


def test_a_start_that_was_not_attacked_is_not_asked_for(tmp_path):
    put(tmp_path, "clean", 0, attacked=False)
    with pytest.raises(ValueError, match=r"run=\S+/clean/seed0 suite=recipes"):
        read(tmp_path)  # it is all there is
    put(tmp_path, "good", 0)
    assert read(tmp_path).commands == []


def test_an_epoch_in_which_the_machine_slept_does_not_count(tmp_path):
    folder = put(tmp_path, "good", 0, seconds=3612.0, start=10.0)
    metrics = metrics_in(folder)
    for side, seconds in (
        (metrics, (5.0, 3600.0, 7.0)),
        (metrics["start"], (4.0, 4.0)),
        (metrics["baseline"], (3.0, 900.0, 3.0, 900.0, 3.0)),
    ):
        side["train"]["history"] = [{"seconds": s} for s in seconds]
    write(folder, metrics)
    (run,) = read(tmp_path).runs.itertuples()
    assert (run.seconds, run.start_seconds, run.total_seconds) == (21.0, 8.0, 29.0)
    assert run.plain_seconds == 5 * 3.0 + 8.0
    assert run.images_per_second == pytest.approx(600.0 * 3612 / 21)


def test_an_attack_in_another_scene_does_not_count(tmp_path):
    folder = put(tmp_path, "good", 0)
    (folder / "reattack/screen_photo-n200-steps50").rename(folder / "reattack/elsewhere")
    assert len(read(tmp_path).runs) == 1  # whatever its folder is called
    attack, other = attack_of(folder), Scene.preset("phone_at_laptop").to_dict()
    write(attack, metrics_in(attack) | {"scene": other})
    with pytest.raises(ValueError, match=r"(?s)own scene. Run:.*run=\S+/good/seed0 suite=recipes"):
        read(tmp_path)


def test_an_attack_on_other_images_does_not_count(tmp_path):
    """However many they are."""
    folder = put(tmp_path, "good", 0)
    again = metrics_in(attack_of(folder))
    again["config"]["data"] |= {"name": "folder", "root": "other"}
    cells = [line | {"outcomes": "0" * 1000} for line in again["tables"]["worst_case"]]
    again |= {"n": 1000, "tables": again["tables"] | {"worst_case": cells}}
    write(folder / "reattack/other-n1000/recipes", again)
    (outcomes,) = read(tmp_path).runs["clean"]
    assert outcomes.mean() == 0.9


def test_worst_cases_of_other_attackers_do_not_compare(tmp_path):
    for seed in range(3):
        attack = attack_of(put(tmp_path, "good", seed))
    again = metrics_in(attack)
    again["tables"]["worst_case"].append(cell("eps_4", "adaptive", 0.2, again["n"]))
    write(attack, again)
    with pytest.raises(ValueError, match=r"attackers cannot be compared: \S+good/seed2 has"):
        read(tmp_path)


ODD = [
    ({"data": "cifar10"}, r"data.name cannot .*odd/seed0 has cifar10, most others"),
    ({"size": 32}, "data.size cannot be compared: .* has 32, most others have 48"),
    ({"scene": "phone_at_laptop"}, ".* phone_at_laptop, .* have screen_photo"),
    ({"steps": 20}, "reattack.steps cannot be compared: .* has 20, most others have 50"),
    ({"decay": 5e-4}, "train.weight_decay cannot .* has 0.0005, most others have null"),
    ({"n": 480}, r"reattack.n cannot be compared: \S+odd/seed0 has 480"),
    ({"weights": "DEFAULT"}, "weights cannot be compared.*DEFAULT, most"),
]


def test_what_does_not_compare_is_named(root):
    put(root, "short", 0, length=0.5)  # a shorter recipe does
    assert "short" in set(read(root).runs["recipe"])
    for odd, message in ODD:
        folder = put(root, "odd", 0, **odd)
        with pytest.raises(ValueError, match=f"with different {message}"):
            read(root)
        shutil.rmtree(folder)


def test_the_largest_re_attack_of_a_run_counts(root):
    larger = []
    for folder in sorted(root.glob("*/seed*")):
        write(folder / "reattack/smaller/recipes", metrics_in(attack_of(folder)) | {"n": 32})
        larger.append((folder, metrics_in(folder / "reattack/screen_photo-n200-steps50/recipes")))
    assert read(root).shared["n"] == 200
    for folder, attack in larger:
        write(folder / "reattack/larger/recipes", attack | {"n": 960})
    assert read(root).shared["n"] == 960


def test_a_demoireing_network_has_no_place_in_the_table(root):
    network = {"recipe": "demoire", "seed": 0, "train": {"seconds": 1.0}, "config": {"data": {}}}
    write(root / "demoire/seed0", network)
    write(root / "folder-pics-esdnet/demoire/seed0", network)
    found = read(root)
    assert len(found.runs) == 10 and not found.warnings
    with pytest.raises(ValueError, match="no finished run"):
        read(root / "folder-pics-esdnet")


def test_a_run_whose_metrics_are_damaged_is_named(root):
    (root / "good/seed0/metrics.json").write_text("{")
    (said,) = read(root).warnings
    assert "good/seed0/metrics.json is damaged, and the run left out" in said


def test_mistakes_get_a_sentence(tmp_path):
    for argv, said in (
        ([str(tmp_path / "nowhere")], r"no finished run in \S+"),
        ([], "runs must be given, as in: python training/frontier.py runs"),
        (["a", "b"], "pass one folder of runs"),
    ):
        with pytest.raises(SystemExit, match=f"error: {said}"):
            command.main(argv)
    folder = put(tmp_path, "good", 0)
    metrics = metrics_in(folder)
    train = metrics["train"]
    lacking = {key: value for key, value in train.items() if key != "passes"}
    for change, said in (
        ({"baseline": None, "start": None}, r"no run writes \(KeyError\('start'\)\)\. Train and"),
        ({"config": None}, r"no run writes \(TypeError\(.*\)\)\. Train and"),
        ({"train": train | {"history": []}}, r"\(ZeroDivisionError\(.*\)\)\. Train and"),
        ({"train": lacking}, "lacks 'passes': another version"),
    ):
        write(folder, metrics | change)
        with pytest.raises(ValueError, match=said):
            read(tmp_path)


def test_a_folder_of_images_goes_by_its_own_name(tmp_path):
    """Which may have moved between training and attack."""
    put(tmp_path, "clean", 0, data="folder", at="somewhere/gtsrb")
    put(tmp_path, "good", 0, data="folder", at="elsewhere/gtsrb/")
    assert read(tmp_path).shared["data"] == "gtsrb"
    put(tmp_path, "good", 1, data="folder", at="elsewhere/moved")
    assert read(tmp_path).shared["data"] == "folder"
    path = attack_of(put(tmp_path / "cifar", "good", 0, data="cifar10", at="here")) / "metrics.json"
    path.write_text(path.read_text().replace('"root": "here"', '"root": "there"'))
    assert len(read(tmp_path / "cifar").runs) == 1


def test_times_of_two_machines_and_failed_checks_are_said(tmp_path):
    failed = {"name": "many steps beat one", "verdict": "fail", "says": ""}
    put(tmp_path, "clean", 0, trust=[failed, failed | {"verdict": "pass", "name": "fine"}])
    put(tmp_path, "good", 0, device={"device": "NVIDIA H100"})
    machines, checks = read(tmp_path).warnings
    assert "in different ways (NVIDIA H100; a slow one, 2 threads)" in machines
    assert checks.endswith(f"failed on {tmp_path / 'clean/seed0'}: many steps beat one.")


def test_the_machine_of_a_plain_run_counts(tmp_path):
    """Its time is part of all others, or their unit."""
    folder = put(tmp_path, "good", 0)
    assert not read(tmp_path).warnings
    metrics = metrics_in(folder)
    for role in ("start", "baseline"):
        write(folder, metrics | {role: metrics[role] | {"environment": {"device": "NVIDIA H100"}}})
        (said,) = read(tmp_path).warnings
        assert "in different ways (NVIDIA H100; a slow one" in said


def test_costs_need_the_time_of_plain_training(tmp_path):
    put(tmp_path, "clean", 0)
    with pytest.raises(ValueError, match="train and attack recipe baseline with the same settings"):
        summarise(read(tmp_path).runs)
    put(tmp_path, "baseline", 1, seconds=30.0)  # trained anew, on a slower day
    put(tmp_path, "good", 1, seconds=30.0)
    clean, baseline, good = summarise(read(tmp_path).runs)
    assert clean.relative_time.value == 10.0 / (40.0 + 30.0) * 2
    assert (baseline.relative_time.value, good.relative_time.value) == (1.0, 40.0 / 30.0)


def test_seeds_of_other_settings_are_not_one_recipe(tmp_path):
    for seed in range(3):
        put(tmp_path, "good", seed, eps=0.03 if seed == 1 else 0.02)
        put(tmp_path, "other", seed, eps=0.04)  # another recipe may have its own
    with pytest.raises(ValueError, match=r"different adversary.eps .*good/seed1 has 0.03"):
        read(tmp_path)


def test_an_attack_on_an_unfinished_run_does_not_count(tmp_path):
    """Its weights are others than those of the finished run."""
    folder = put(tmp_path, "good", 0)
    metrics, attack = metrics_in(folder), attack_of(folder)
    again = metrics_in(attack)
    write(folder, metrics | {"identity": "after"})
    write(attack, again | {"identity": "before"})
    with pytest.raises(ValueError, match=r"(?s)own scene. Run:.*good/seed0 suite=recipes"):
        read(tmp_path)
    write(folder / "reattack/later/recipes", again | {"identity": "after"})
    assert len(read(tmp_path).runs) == 1


@pytest.mark.parametrize(
    ("plain", "own", "length", "paired"),
    [(12, 12, 1.0, True), (6, 12, 1.0, False), (6, 12, 0.5, True), (24, 12, 1.0, True)],
)
def test_no_gain_is_given_over_shorter_training(plain, own, length, paired, tmp_path):
    for recipe, epochs in (("clean", plain), ("baseline", plain), ("good", own)):
        folder = put(tmp_path, recipe, 0, length=length if recipe == "good" else 1.0)
        metrics = metrics_in(folder)
        metrics["config"]["train"]["epochs"] = epochs
        write(folder, metrics)
    found = read(tmp_path)
    baselines = found.runs.dropna(subset="baseline").set_index("recipe")["baseline"].to_dict()
    assert baselines == ({"good": "baseline"} if paired else {})
    said = [text for text in found.warnings if text.startswith("No gain is given for good")]
    assert len(said) == (0 if paired else 1)
