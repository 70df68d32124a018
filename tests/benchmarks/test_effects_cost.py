"""What the table of effects leaves out and adds."""

import pytest

from benchmarks import effects_cost, measure
from moireaug import Scene
from moireaug.scene.by_name import with_values


@pytest.mark.parametrize(
    ("kind", "cost"), [("left out", 6.0), ("added", -6.0), ("always there", 2.0)]
)
def test_an_effect_costs_what_it_adds_to_the_photo(kind, cost):
    times = {"whole": measure.Timing.of([8.0]), "it": measure.Timing.of([2.0])}
    row = effects_cost.effect_row("it", kind, Scene(), times)
    assert row["seconds"] == cost and row["share"] == cost / 8


@pytest.mark.parametrize("name", effects_cost.WITHOUT)
def test_the_default_photo_has_what_is_left_out(name):
    """All of it in the plan, nothing of it without; `saturate` goes with a gain that cannot exceed
    the full well."""
    whole = Scene.preset(effects_cost.DEFAULT)
    bare = with_values(whole, effects_cost.WITHOUT[name])
    for effect in name.split(", "):
        assert effect in whole.plan() and effect not in bare.plan()


@pytest.mark.parametrize("name", effects_cost.WITH)
def test_what_is_added_is_not_in_the_default_photo(name):
    whole = Scene.preset(effects_cost.DEFAULT)
    more = with_values(whole, effects_cost.WITH[name])
    assert str(more.plan()) != str(whole.plan())
    # else it is another kind of one that is there
    if name in {step.name for step in whole.plan().steps}:
        assert name in more.plan() and name not in whole.plan()
