"""Rivals beside an independent implementation, torchattacks, and random search beside chance."""

import copy

import pytest
import torch
from torch import nn

from moireaug import Lens, Panel, Scene, Sensor, attacks, capture
from moireaug.attacks import BIM, CW, MIFGSM, PGD, MoireAttack, SquareMoire
from moireaug.attacks.square import window_side
from tests.attacks.common import counting, quietly

SCENE = Scene(panel=Panel(scale=1.1), lens=Lens(blur=0.25), sensor=Sensor(scale=2.0, gain=2.0))
EPS = 8 / 255


@pytest.fixture(scope="module")
def learnt(trained):
    """Logits above 0 (torchattacks' CW takes 0 for the logit left out), and images away from black
    and white, where torchattacks projects and we have no gradient."""
    g = torch.Generator().manual_seed(0)
    images, labels = torch.rand(32, 3, 16, 16, generator=g) * 0.6 + 0.2, torch.arange(32) % 5
    images[torch.arange(32), 0, :, labels * 3] *= 0.7  # the class is where a column is dark
    model = copy.deepcopy(trained(images, labels))
    with torch.no_grad():
        model.net[-1].bias += 50
        return model, images, model(images).argmax(1)


@pytest.mark.parametrize("name", ["BIM", "MIFGSM", "PGD"])
@pytest.mark.parametrize("targeted", [False, True])
def test_the_same_images_as_torchattacks(name, targeted, learnt):
    model, images, labels = learnt
    goal = (labels + 1) % 5 if targeted else labels

    start = {"random_start": 0} if name == "PGD" else {}

    @torch.enable_grad()
    def of(steps):
        library = quietly("torchattacks")
        attack = getattr(library, name)(model, eps=EPS, alpha=EPS / 4, steps=steps, **start)
        if targeted:
            attack.set_mode_targeted_by_label(quiet=True)
        return attack(images, goal)

    kind = {"BIM": BIM, "MIFGSM": MIFGSM, "PGD": PGD}[name]
    ours = kind(model, eps=EPS, step_size=0.25, steps=6, **start)
    result = ours(images, labels, goal if targeted else None)
    with torch.no_grad():
        for k in (1, 4):  # the losses before each step are those of as many steps of theirs
            theirs = nn.functional.cross_entropy(model(of(k)), goal)
            assert torch.allclose(result.loss[k], theirs, atol=1e-5)
        expected = of(6)
        hit = model(expected).argmax(1) == goal
    theirs_rate = (hit if targeted else ~hit).float().mean()
    assert result.success.float().mean() >= theirs_rate > 0.2
    if not targeted:
        assert (ours.last(images, labels) - expected).abs().max() < 1e-5


@pytest.mark.parametrize("targeted", [False, True])
@pytest.mark.parametrize(("c", "lr"), [(0.1, 0.01), (0.2, 0.003), (1.0, 0.01)])
def test_cw_agrees_with_torchattacks(targeted, c, lr, learnt):
    model, images, labels = learnt
    # in float64: Adam divides by the size of a gradient, and would make steps of what rounding
    # leaves of a zero
    model, images = copy.deepcopy(model).double(), images.double()
    other = quietly("torchattacks").CW(model, c=c, kappa=0, steps=50, lr=lr)
    targets = (labels + 1) % 5 if targeted else None
    if targeted:
        other.set_mode_targeted_by_label(quiet=True)
    expected = other(images, targets if targeted else labels)
    ours = CW(model, c=c, steps=50, lr=lr)(images, labels, targets)
    goal = model(expected).argmax(1)
    success = goal == targets if targeted else goal != labels
    assert torch.equal(ours.success, success) and success.float().mean() > 0.2
    ours_far, far = ((x - images).flatten(1).norm(dim=1)[success] for x in (ours.images, expected))
    if c == 1:  # there it stops the whole batch as soon as its cost has risen
        assert (ours_far <= far * (1 + 1e-3)).all()
    else:
        assert torch.allclose(ours_far, far, rtol=1e-3)
        # all but the last row and column, which the model does not read: there rounding does lead
        # astray
        assert ours.images.sub(expected)[..., :-1, :-1].abs().max() < 1e-5
    assert torch.equal(ours.images[~ours.success], images[~ours.success])
    assert ours.eps == ours.noise.abs().max()


def test_cw_with_more_confidence_goes_farther(learnt):
    model, images, labels = learnt
    results = [CW(model, confidence=kappa, steps=80)(images, labels) for kappa in (0.0, 1.0)]
    margins = [attacks.margin(model(r.images), labels) for r in results]
    both = results[0].success & results[1].success
    assert both.float().mean() > 0.5 and (margins[1][both] >= 1).all()
    near, far = (r.noise.flatten(1).norm(dim=1)[both] for r in results)
    assert (far > near).all()


@pytest.mark.parametrize(("scale", "suits_c"), [(0.01, False), (100.0, True)])
def test_the_search_for_c_finds_the_distance_to_a_plane(scale, suits_c):
    """|margin| / |w|, whatever the scale of the logits, which one c alone does not suit."""
    g = torch.Generator().manual_seed(0)
    weight = torch.randn(3 * 8 * 8, generator=g, dtype=torch.float64)
    images = torch.rand(4, 3, 8, 8, generator=g, dtype=torch.float64) * 0.2 + 0.4
    offset = (images.flatten(1) @ weight).max() + weight.norm() / 2

    def model(x):
        z = scale * (x.flatten(1) @ weight - offset)
        return torch.stack([z, -z], 1)

    labels = model(images).argmax(1)
    distance = (images.flatten(1) @ weight - offset).abs() / weight.norm()
    ratios = []
    for searches in (1, 9):
        result = CW(model, c=1e-3, binary_search_steps=searches, steps=60)(images, labels)
        ratios.append(result.noise.flatten(1).norm(dim=1) / distance)
    assert result.success.all() and (ratios[1] >= 1).all() and (ratios[1] < 1.05).all()
    assert (ratios[0] > 0).all() == suits_c


def test_cw_reaches_from_black_and_white():
    """Black and white lie at infinity in tanh space; they are moved in, and gradients arrive."""
    images = torch.stack([torch.zeros(3, 4, 4), torch.ones(3, 4, 4)])

    def model(x):
        return torch.stack([x.mean((1, 2, 3)) - 0.3, 0.7 - x.mean((1, 2, 3))], 1)

    result = CW(model, c=1e4, steps=60, lr=0.3)(images, torch.tensor([1, 0]))
    assert result.success.all() and result.images.isfinite().all()


def test_square_needs_no_gradient_and_beats_chance(learnt, trained):
    _, images, labels = learnt
    shot = SCENE.sample(len(images), (16, 16))
    model = trained(capture(images, shot), labels)

    def blind(x):
        assert not torch.is_grad_enabled() and not x.requires_grad
        return model(x).detach()

    g = torch.Generator().manual_seed(5)
    settings = {"scene": SCENE, "eps": 4 / 255}
    result = SquareMoire(blind, steps=60, **settings)(images, labels, shot=shot, generator=g)
    chance = (torch.randint(0, 2, shot.raw_shape(), generator=g) * 2.0 - 1) * settings["eps"]
    with_gradient = MoireAttack(model, steps=10, **settings)(images, labels, shot=shot)
    photos = [result.images, capture(images, shot, chance), capture(images, shot)]
    margins = (attacks.margin(model(x), labels).mean() for x in (*photos, with_gradient.images))
    found, by_chance, clean, white = margins
    assert white > found > by_chance + 0.15 * (white - clean)
    # every value at a corner
    assert torch.allclose(result.noise.abs(), torch.tensor(settings["eps"]))
    with pytest.raises(ValueError, match=r"logits have no gradient.*SquareMoire"):
        MoireAttack(lambda x: model(x).detach(), scene=SCENE, steps=1)(images, labels, shot=shot)


def test_square_asks_once_a_step_and_never_gets_worse(learnt):
    """Nor does a first query without an answer end the search."""
    model, images, labels = learnt
    shot, margins = SCENE.sample(len(images), (16, 16), torch.Generator().manual_seed(1)), []
    for steps in (1, 20, 60):
        counted, asked = counting(model)
        attack, start = SquareMoire(counted, scene=SCENE, steps=steps), torch.Generator()
        photos = attack.last(images, labels, shot=shot, generator=start.manual_seed(2))
        margins.append(attacks.margin(model(photos), labels))
        assert len(asked) == steps
    assert (margins[1] >= margins[0] - 1e-5).all() and margins[2].mean() > margins[0].mean()
    late, asked = counting(lambda x: model(x) * (float("nan") if len(asked) == 1 else 1.0))
    photos = SquareMoire(late, scene=SCENE, steps=20).last(images, labels, shot=shot)
    assert attacks.margin(model(photos), labels).mean() > margins[0].mean()


def test_squares_shrink_as_in_the_paper():
    shape = (1, 4, 100, 100)
    assert window_side(0, 10_000, shape) == round((0.8 * 100 * 100) ** 0.5) == 89
    assert window_side(11, 10_000, shape) == round((0.4 * 100 * 100) ** 0.5)
    assert window_side(9_999, 10_000, shape) == round((0.8 / 2**9 * 100 * 100) ** 0.5)
    assert window_side(99, 100, shape) == window_side(9_999, 10_000, shape)
    assert window_side(0, 10, (1, 3, 4, 1000)) == 4 and window_side(9, 10, (1, 3, 2, 2)) == 1
