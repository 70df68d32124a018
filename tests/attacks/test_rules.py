"""Update rules: against what their papers say, and against each other."""

import pytest
import torch
from torch import nn

from moireaug import Develop, Lens, Panel, Scene, Sensor, attacks, capture, develop, expose
from moireaug.attacks import LOSSES, PGD, MoireAttack
from moireaug.attacks.rules import RULES, Ball, checkpoints

SCENE = Scene(
    panel=Panel(scale=1.1), lens=Lens(blur=0.25), sensor=Sensor(scale=2.0, gain=2.0), develop=Develop(brighten=0.1)
)
EPS = 4 / 255


def ascend(rule, gradient_of, steps, x, **ball):
    """What a rule makes of a loss whose gradient is known: (steps + 1, *x.shape)."""
    rule = RULES[rule](Ball(1.0, 1.0, steps, **ball))
    path = [x]
    for _ in range(steps):
        x = path[-1].requires_grad_()
        loss = gradient_of(x)
        (gradient,) = torch.autograd.grad(loss.sum(), x)
        path.append(rule(x.detach(), gradient, loss.detach()))
    return torch.stack([p.detach() for p in path])


def test_halving_looks_back_where_the_paper_says():
    assert checkpoints(100) == {22, 41, 57, 70, 80, 87, 93, 99}
    assert checkpoints(0) == {0} and max(checkpoints(1)) == 1  # a single step is never looked back on


def test_momentum_is_the_papers_sum():
    """g = g + gradient / mean|gradient|, per image: a weak late gradient does not turn a strong early direction."""
    slopes = torch.tensor([[[2.0, -1.0]], [[-1.0, -1.0]], [[-1.0, 8.0]]])  # three steps of one image, two variables
    rule, x = RULES["momentum"](Ball(1.0, 1.0, 10, 0.1)), torch.zeros(1, 2)
    # normalised: (4/3, -2/3), (-1, -1), (-2/9, 16/9); summed: (4/3, -2/3), (1/3, -5/3), (1/9, 1/9)
    for slope, expected in zip(slopes, [(0.1, -0.1), (0.2, -0.2), (0.3, -0.1)], strict=True):
        x = rule(x, slope * 1e-30, torch.zeros(1))
        assert torch.allclose(x, torch.tensor([expected]))
    assert rule(x, torch.zeros(1, 2), torch.zeros(1)).isfinite().all()


def test_the_first_halving_step_crosses_the_ball():
    path = ascend("halving", lambda x: x.sum(1), 4, -torch.ones(2, 3))
    assert path[1].eq(1).all()


def test_halving_closes_in_where_signs_go_to_and_fro():
    """On a bowl whose floor lies inside the ball, fixed steps stay a step away; halved ones come nearer."""
    g = torch.Generator().manual_seed(0)
    floor = torch.rand(8, 5, generator=g) * 1.2 - 0.6
    mixed = torch.randn(5, 5, generator=g) * 0.4 + torch.eye(5)

    def loss(x):
        return -((x - floor) @ mixed).square().sum(1)

    best = {
        r: torch.stack([loss(p) for p in ascend(r, loss, 40, torch.zeros(8, 5))]).amax(0)
        for r in RULES
        if r != "printed"
    }
    assert (best["halving"] > best["sign"]).all()
    assert best["halving"].mean() > best["sign"].mean() / 4


class Curved(nn.Module):
    """Two classes by the distance to a point that lies inside every image's ball."""

    def __init__(self, point, mixed):
        super().__init__()
        self.point, self.mixed = point, mixed

    def forward(self, x):
        far = ((x - self.point).flatten(1) @ self.mixed).square().sum(1)
        return torch.stack([far, 1e-3 - far], 1)


def test_halving_is_at_least_as_strong_as_sign():
    g = torch.Generator().manual_seed(2)
    images = torch.rand(4, 3, 4, 4, generator=g) * 0.2 + 0.4
    point = images + (torch.rand(images.shape, generator=g) - 0.5) * EPS
    model = Curved(point, torch.eye(48) + torch.randn(48, 48, generator=g) * 0.05)
    labels, reached = torch.zeros(4, dtype=torch.long), {}
    for rule in ("sign", "halving"):
        result = PGD(model, eps=EPS, steps=30, rule=rule, random_start=0.0)(images, labels)
        reached[rule] = attacks.margin(model(result.images), labels)
    assert (reached["halving"] >= reached["sign"]).all()


def test_printed_adds_the_whole_delta_at_every_step():
    """On a linear model every gradient has the same sign: delta grows by eps / K, the total to (K + 1) / 2 eps."""
    g = torch.Generator().manual_seed(1)
    weight = torch.randn(2, 192, generator=g)

    def model(x):
        return x.flatten(1) @ weight.to(x).T

    images, labels = torch.rand(3, 3, 8, 8, generator=g) * 0.2 + 0.4, torch.tensor([0, 1, 0])
    shot = SCENE.sample(3, (8, 8))
    for steps in (1, 4, 9):
        printed, sign = (
            MoireAttack(model, scene=SCENE, eps=EPS, steps=steps, step_size=1 / steps, rule=rule)(
                images, labels, shot=shot
            )
            for rule in ("printed", "sign")
        )
        felt = sign.noise != 0
        assert torch.allclose(printed.noise[felt], sign.noise[felt] * (steps + 1) / 2, atol=1e-6)
        assert torch.allclose(sign.noise[felt].abs(), torch.tensor(EPS))
        assert torch.allclose(capture(images, shot, printed.noise), printed.images, atol=1e-6)


def test_printed_is_algorithm_1_step_by_step(model, batch):
    """Beside a plain transcription, on a model with curvature and readings that reach both bounds."""
    (images, labels), steps, eps = batch, 5, 0.2
    model.eval()
    shot = SCENE.sample(6, (16, 16))
    attack = MoireAttack(model, scene=SCENE, eps=eps, steps=steps, rule="printed")
    x, delta = expose(images, shot), 0.0
    for _ in range(steps):
        x = x.detach().requires_grad_()
        (gradient,) = torch.autograd.grad(LOSSES["ce"](model(develop(x, shot)), labels).sum(), x)
        delta = (delta + eps / steps * gradient.sign()).clamp(-eps, eps)
        x = (x.detach() + delta).clamp(0, 1)
    assert torch.allclose(attack.last(images, labels, shot=shot), develop(x, shot), atol=1e-4)
    result = attack(images, labels, shot=shot)
    assert eps < result.noise.abs().max() <= 3 * eps * (1 + 1e-6)
    reading = expose(images, shot) + result.noise
    assert reading.min() > -1e-6 and reading.max() < 1 + 1e-6
    assert torch.allclose(capture(images, shot, result.noise), result.images, atol=1e-6)


@pytest.mark.parametrize("rule", RULES)
def test_where_there_is_no_gradient_nothing_moves(rule):
    ball = {"base": torch.full((2, 3), 0.5)}
    path = ascend(rule, lambda x: (x * 0).sum(1), 6, torch.full((2, 3), 0.1), **ball)
    assert torch.allclose(path[-1], path[0])


def test_the_ratio_is_scale_free_and_takes_the_papers_form():
    logits = torch.tensor([[4.0, 1.0, 2.0, -3.0], [0.0, 1.0, 5.0, 3.0]])
    labels = torch.tensor([0, 0])
    # equation 6: -(z_y - greatest other) / (greatest - third greatest)
    expected = torch.tensor([-(4.0 - 2.0) / (4.0 - 1.0), -(0.0 - 5.0) / (5.0 - 1.0)])
    for scale in (1.0, 1e4, 1e-4):
        assert torch.allclose(LOSSES["dlr"](logits * scale, labels), expected)
    assert LOSSES["dlr"](torch.zeros(2, 3), labels).tolist() == [0, 0]


def test_the_ratio_does_not_hide_a_target_that_is_third():
    logits = torch.tensor([[4.0, 1.0, 2.0, -3.0]], requires_grad=True)
    loss = LOSSES["dlr"](logits, torch.tensor([1]))
    assert loss.item() == 1
    (gradient,) = torch.autograd.grad(loss, logits)
    assert gradient[0, 1] < 0 < gradient[0, 0]
