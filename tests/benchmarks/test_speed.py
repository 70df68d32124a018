"""What the rows of speed and memory are measured on."""

from benchmarks import speed


def test_panels_are_lit_as_their_rows_say():
    plain, scenes = speed.black_matrices((0.35, 0.9))
    for scene in (plain, *scenes.values()):
        assert scene.panel.lit_x == scene.panel.lit_y == 1
    assert plain.panel.lit == 1
    assert {name: scene.panel.lit for name, scene in scenes.items()} == {
        "expose, rgb_stripe, lit 0.35": 0.35,
        "expose, rgb_stripe, lit 0.9": 0.9,
        "expose, pentile, lit 0.35": 0.35,
        "expose, pentile, lit 0.9": 0.9,
    }


def test_a_scene_without_a_lattice_has_none():
    assert not speed.without_lattice().plan().harmonics
