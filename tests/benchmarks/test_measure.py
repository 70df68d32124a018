"""What benchmarks measure on, how they take times and judge them, and where the results go."""

import json
import sys

import pytest
import torch
from hydra import initialize

from benchmarks import accuracy_vs_time, effects_cost, measure, panels, sass, speed, training_steps
from benchmarks.rows import Row
from moireaug import Lens, Panel, Scene, Sensor, View, expose
from moireaug.common import image_files
from moireaug.scene.by_name import with_values
from training.data import image_sets


def test_the_reference_says_how_far_it_is_off():
    """Against sixteen times as many points."""
    scene = Scene(
        panel=Panel(scale=1.4), view=View(roll=5), lens=Lens(blur=0.3), sensor=Sensor(scale=2)
    )
    image = torch.rand(1, 3, 12, 12, dtype=torch.float64)
    reading, error_left = accuracy_vs_time.converged(scene, image, 4)
    shot = accuracy_vs_time.draw(accuracy_vs_time.with_method(scene, "supersample:16"), image)
    off = accuracy_vs_time.rms(reading - expose(image, shot), reading)
    assert 0.4 * error_left < off < 2 * error_left


def test_candidates_take_turns_and_slow_ones_sit_out():
    seen = []
    calls = {"a": lambda: seen.append("a"), "b": lambda: seen.append("b")}
    times = measure.timed_together(calls, repeats=5, warmup=1, budget=0.0)
    assert seen[:2] == ["a", "b"] and seen.count("a") == seen.count("b") == 1 + measure.MIN_RUNS
    one = times["a"]
    assert one.runs == measure.MIN_RUNS and one.low <= one.median <= one.high


def test_a_table_leaves_out_what_is_unknown():
    rows = [{"name": "a", "value": 1234.5, "memory": None}, {"name": "b", "value": 0.123456}]
    lines = measure.text_of_rows(rows).splitlines()[1:]
    assert [line.split() for line in lines] == [["a", "1234"], ["b", "0.123"]]


SASS = """
        /*0000*/                   MOV R1, c[0x0][0x28] ;      /* 0x00000a0000017a02 */
        /*0010*/              @!P0 BRA 0x40 ;                  /* 0x0000000000000947 */
        /*0020*/                   LDG.E R2, [R4.64] ;         /* 0x0000000404027981 */
        /*0030*/               @P1 BRA 0x20 ;                  /* 0x0000000000001947 */
        /*0040*/                   EXIT ;                      /* 0x000000000000794d */
        /*0050*/                   BRA 0x50;                   /* 0xfffffff000007947 */
        /*0060*/                   NOP;                        /* 0x0000000000007918 */
"""


def test_instructions_in_a_loop_count_as_often_as_it_runs():
    assert sass.instruction_count(SASS, ()) == (6, "?")
    assert sass.instruction_count(SASS, (10,)) == (4 + 2 * 10, "10")


def test_an_unrolled_loop_is_followed_by_its_rest():
    twice = SASS.replace("LDG.E R2", "LDG.E R2, [R6.64] ;\n /*0028*/ LDG.E R2")
    rest = "/*0070*/ LDG.E R2, [R4.64] ; /*0080*/ @P1 BRA 0x70 ;"
    # five steps of two loads and a branch, one of one load and a branch
    assert sass.instruction_count(twice + rest, (11,)) == (4 + 5 * 3 + 2, "5 1")


def test_an_effect_costs_what_it_adds_to_the_photo():
    times = {"whole": measure.Timing.of([8.0]), "it": measure.Timing.of([2.0])}
    for kind, cost in (("left out", 6.0), ("added", -6.0), ("always there", 2.0)):
        row = effects_cost.effect_row("it", kind, Scene(), times)
        assert row["seconds"] == cost and row["share"] == cost / 8, kind


def test_the_default_photo_has_what_is_left_out_and_not_what_is_added():
    """`saturate` goes with a gain that cannot exceed the full well."""
    whole = Scene.preset(effects_cost.DEFAULT_SCENE)
    for name, values in effects_cost.REMOVED_EFFECTS.items():
        bare = with_values(whole, values)
        for effect in name.split(", "):
            assert effect in whole.plan() and effect not in bare.plan(), name
    for name, values in effects_cost.ADDED_EFFECTS.items():
        more = with_values(whole, values)
        assert str(more.plan()) != str(whole.plan()), name
        # else it is another kind of one that is there
        if name in {step.name for step in whole.plan().steps}:
            assert name in more.plan() and name not in whole.plan()


def test_panels_are_lit_as_their_rows_say():
    plain, scenes = panels.black_matrices((0.35, 0.9))
    for scene in (plain, *scenes.values()):
        assert scene.panel.lit_x == scene.panel.lit_y == 1
    assert plain.panel.lit == 1
    layouts = ("rgb_stripe", "pentile")
    lit = {f"expose, {layout}, lit {share}": share for layout in layouts for share in (0.35, 0.9)}
    assert {name: scene.panel.lit for name, scene in scenes.items()} == lit


def test_one_group_leaves_the_results_of_all_alone(monkeypatch, tmp_path):
    def panels(size):
        yield Row("a row", 1.0, 1.0, 1.0, "ms")

    whole = tmp_path / "speed.json"
    whole.write_text("all of them")
    monkeypatch.setattr(speed, "GROUPS", (panels, speed.executions))
    given = ["--quick", "--threads", "1", "--out", str(tmp_path), "--only", "panels"]
    monkeypatch.setattr(sys, "argv", ["speed.py", *given])
    speed.main()
    assert whole.read_text() == "all of them"
    written = json.loads((tmp_path / "speed-panels.json").read_text())
    assert [row["what"] for row in written["rows"]] == ["a row"]


@pytest.mark.parametrize(("source", "again"), [("files", 4), ("memory", 0)])
def test_a_pass_reads_what_its_row_says(monkeypatch, tmp_path, source, again):
    training_steps.write_folder(tmp_path, 4, 16)
    opened = []
    monkeypatch.setattr(
        image_sets,
        "read_picture",
        lambda path: opened.append(path) or image_files.read_picture(path),
    )
    given = ["data=folder", "data.size=16", "data.val=2", "train.batch_size=2"]
    with initialize(version_base="1.3", config_path=None):
        cfg = training_steps.configure("recipe=clean", *given, f"data.root={tmp_path}")
    loader = training_steps.loader_of(cfg, source, 0)
    list(loader)
    assert len(opened) == 4
    list(loader)
    assert len(opened) == 4 + again
