"""Update rules: against what their papers say."""

import math

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, capture, develop, expose
from moireaug.attacks import LOSSES, MoireAttack
from moireaug.attacks.pixel import PixelProblem
from moireaug.attacks.rules import RULES, checkpoints

SCENE = Scene(
    panel=Panel(scale=1.1),
    lens=Lens(blur=0.25),
    sensor=Sensor(scale=2.0, gain=2.0),
    develop=Develop(brighten=0.1),
)
EPS = 4 / 255


def ascend(rule, gradient_of, steps, x, problem=None):
    """What a rule makes of a loss whose gradient is known: (steps + 1, *x.shape)."""
    rule = RULES[rule](1.0, steps, problem=problem)
    path = [x]
    for _ in range(steps):
        x = path[-1].requires_grad_()
        loss = gradient_of(x)
        (gradient,) = torch.autograd.grad(loss.sum(), x)
        path.append(rule(x.detach(), gradient, loss.detach()))
    return torch.stack([p.detach() for p in path])


def test_apgd_looks_back_where_the_paper_says():
    assert checkpoints(100) == {22, 41, 57, 70, 80, 87, 93, 99}
    # a single step is never looked back on
    assert checkpoints(0) == {0} and max(checkpoints(1)) == 1


def test_momentum_is_the_papers_sum():
    """g = g + gradient / mean|gradient|, per image: a weak late gradient turns no direction."""
    # three steps of one image, two variables
    slopes = torch.tensor([[[2.0, -1.0]], [[-1.0, -1.0]], [[-1.0, 8.0]]])
    rule, x = RULES["momentum"](1.0, 10, 0.1), torch.zeros(1, 2)
    # normalised: (4/3, -2/3), (-1, -1), (-2/9, 16/9); summed: (4/3, -2/3), (1/3, -5/3), (1/9, 1/9)
    for slope, expected in zip(slopes, [(0.1, -0.1), (0.2, -0.2), (0.3, -0.1)], strict=True):
        x = rule(x, slope * 1e-30, torch.zeros(1))
        assert torch.allclose(x, torch.tensor([expected]))
    assert rule(x, torch.zeros(1, 2), torch.zeros(1)).isfinite().all()


def published(value_and_slope, x, steps, low=-1.0, high=1.0):
    """Auto-PGD (Croce & Hein, 2020, Algorithm 1) in plain words: the points x_0 to x_steps."""
    p, marks = [0.0, 0.22], []
    while p[-1] < 1:
        marks.append(math.ceil(p[-1] * steps - 1e-9))
        p.append(p[-1] + max(p[-1] - p[-2] - 0.03, 0.06))
    path, values, best, before = [x], [], -math.inf, x
    eta, rises, mark, halved, best_then = 2.0, 0, 0, False, None
    for k in range(steps):
        value, slope = value_and_slope(x)
        if value > best:
            best, best_x, best_slope = value, x, slope
        if k == 0:
            best_then = best
        elif value > values[-1]:
            rises += 1
        values.append(value)
        if k in marks:
            first = rises < 0.75 * (k - mark)
            second = not halved and best == best_then
            halved = first or second
            if halved:
                eta = eta / 2
                x, slope = best_x, best_slope
                values[-1] = best
            best_then, rises, mark = best, 0, k
        after = (x + eta * slope.sign()).clamp(low, high)
        if k > 0:
            after = (x + 0.75 * (after - x) + 0.25 * (x - before)).clamp(low, high)
        before, x = x, after
        path.append(x)
    return torch.stack(path)


@pytest.mark.parametrize("steps", [1, 9, 40, 100])
@pytest.mark.parametrize("boxed", [False, True])
def test_apgd_is_the_published_algorithm_step_by_step(steps, boxed):
    """Beside a plain transcription, image by image, on waves with many summits."""
    g = torch.Generator().manual_seed(5)
    waves, phase = (
        torch.randn(6, 7, 4, generator=g).double() * 4,
        torch.rand(6, 7, generator=g).double() * 6,
    )

    def loss_of(x, rows=slice(None)):
        return ((x[:, None] * waves[rows]).sum(-1) + phase[rows]).sin().sum(1) + x.sum(1) / 4

    base = torch.rand(6, 4, generator=g).double()
    problem = PixelProblem(base) if boxed else None
    start = torch.zeros(6, 4, dtype=torch.float64)
    path = ascend("apgd", loss_of, steps, start, problem)
    halvings = 0
    for i in range(6):

        def value_and_slope(x, i=i):
            x = x.requires_grad_()
            value = loss_of(x[None], slice(i, i + 1))[0]
            return value.item(), torch.autograd.grad(value, x)[0]

        low, high = (-base[i], 1 - base[i]) if boxed else (-1.0, 1.0)
        expected = published(value_and_slope, start[i].clone(), steps, low, high).detach()
        assert torch.allclose(path[:, i], expected, atol=1e-12), i
        halvings += (expected.diff(dim=0).abs().amax(1) < 0.3).sum()
    assert halvings > 6 or steps < 40  # steps did become small


def test_apgd_halves_where_the_best_is_still_the_first():
    """The second condition alone: a loss that falls, then rises, but never to its start."""
    rule = RULES["apgd"](1.0, 100)
    x = torch.zeros(1, 1)
    for k in range(23):
        loss = k * 1e-3 - 1 if k else 0.0
        x = rule(x, torch.ones(1, 1), torch.tensor([loss]))
    assert rule.step_sizes.item() == 1.0  # of 2 at first
    assert rule.best_loss.item() == 0.0


def test_a_loss_that_is_no_number_is_never_the_best():
    rule = RULES["apgd"](1.0, 10)
    x = torch.zeros(1, 1)
    for loss in (math.nan, 1.0, math.nan, 0.5):
        x = rule(x, torch.ones(1, 1), torch.tensor([loss]))
    assert rule.best_loss.item() == 1.0 and x.isfinite().all()


def test_printed_is_algorithm_1_step_by_step(model, batch):
    """Beside a plain transcription, on readings that reach both bounds."""
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
    assert eps < result.noise.abs().max() <= (steps + 1) / 2 * eps * (1 + 1e-6)
    reading = expose(images, shot) + result.noise
    assert reading.min() > -1e-6 and reading.max() < 1 + 1e-6
    assert torch.allclose(capture(images, shot, result.noise), result.images, atol=1e-6)


@pytest.mark.parametrize("rule", RULES)
def test_where_there_is_no_gradient_nothing_moves(rule):
    start, problem = torch.full((2, 3), 0.1), PixelProblem(torch.full((2, 3), 0.5))
    path = ascend(rule, lambda x: (x * 0).sum(1), 6, start, problem)
    assert torch.allclose(path[-1], path[0])
