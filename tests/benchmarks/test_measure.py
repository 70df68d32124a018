"""How benchmarks take times and judge them."""

import torch

from benchmarks import accuracy_vs_time, measure, sass
from moireaug import Lens, Panel, Scene, Sensor, View, expose


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
