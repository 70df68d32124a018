"""Every attack: what a result says, hard input, any model, and leaving no trace."""

import math

import pytest
import torch
from torch import nn

from moireaug import Lens, Panel, Scene, Sensor, attacks, capture, expose
from moireaug.attacks import PGD, MoireAttack, Normalized
from moireaug.common.numeric import clip
from moireaug.transforms import AdversarialMoire
from tests.attacks.common import EPS, METHODS, SCENE, attack_by, counting, predicted

EXCEEDS = {"ma printed": 2.0, "cw": math.inf}  # by how much the noise may exceed eps in three steps


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def traces(model):
    """Whatever an attack might leave changed in a model."""
    parts = [*model.parameters(), *model.buffers(), *(p.grad for p in model.parameters())]
    flags = [m.training for m in model.modules()] + [p.requires_grad for p in model.parameters()]
    return [part.clone() for part in parts], flags


def assert_untouched(model, before, name):
    (tensors, flags), (now, now_flags) = before, traces(model)
    assert all(map(torch.equal, tensors, now)) and flags == now_flags, name


def half_trained(model, images):
    model.train()
    model.net[1].eval()
    model(images).sum().backward()


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("targeted", [False, True])
def test_a_result_is_what_it_says(name, targeted, model, batch):
    """Also of values a little outside of 0 and 1: the attack begins with clipped ones."""
    outside, labels = (batch[0] * 1.2 - 0.1).clamp(-0.05, 1.05), batch[1]
    images, unchanged = clip(outside), outside.clone()
    targets = (labels + 1) % 5 if targeted else None
    half_trained(model, images)
    before, attack = traces(model), attack_by(name, model, 3)
    result = attack(outside, labels, targets, generator=seeded())
    assert_untouched(model, before, name)
    assert torch.equal(outside, unchanged)
    assert result.images.shape == images.shape
    assert result.images.min() >= 0
    assert result.images.max() <= 1
    assert result.noise.abs().max() <= EPS * EXCEEDS.get(name, 1.0) * (1 + 1e-5)
    # an attack until every image is fooled takes fewer steps
    assert len(result.loss) == 3 or ("until fooled" in name and result.success.all())
    assert result.eps == (result.noise.abs().max() if name == "cw" else EPS)
    hit = predicted(model, result.images)
    assert torch.equal(result.success, hit == targets if targeted else hit != labels)
    if result.shot is None:
        shown = images + result.noise
    elif "photo" in name:
        shown = clip(capture(images, result.shot) + result.noise)
    else:
        shown = capture(images, result.shot, result.noise)
    assert torch.allclose(clip(shown), result.images, atol=1e-6)
    if not targeted:
        again = attack(images, labels, generator=seeded())
        assert torch.equal(again.images, result.images) and torch.equal(again.noise, result.noise)


@pytest.mark.parametrize("name", [*METHODS, "toward ma apgd"])
def test_none_one_and_saturated_logits_on_flat_images(name, model):
    attack = attack_by(name, lambda x: model(x) * 1e4, 2)
    levels, labels = torch.tensor([0.0, 0.5, 1.0]).repeat(2), torch.tensor([0, 0, 0, 1, 1, 1])
    flat = levels[:, None, None, None] * torch.ones(3, 8, 8)
    for n in (0, 1, 6):
        result = attack(flat[:n], labels[:n])
        assert result.images.shape == (n, 3, 8, 8)
        assert len(result.success) == len(result.noise) == n
        assert result.images.isfinite().all() and result.noise.isfinite().all()
        assert n == 0 or result.loss.isfinite().all()
        assert ((result.images >= 0) & (result.images <= 1)).all()


def test_restarts_are_no_worse(model, batch):
    images, labels = batch
    shot, margins = SCENE.sample(6, (16, 16)), []
    for restarts in (1, 4):
        attack = MoireAttack(model, scene=SCENE, eps=EPS, steps=2, restarts=restarts)
        result = attack(images, labels, shot=shot)
        with attacks.evaluating(model), torch.no_grad():
            margins.append(attacks.margin(model(result.images), labels))
    assert (margins[1] >= margins[0] - 1e-5).all()


def exploding(model):
    counted, asked = counting(model)

    def explode(x):
        if asked:
            raise RuntimeError("out of memory")
        return counted(x)

    return explode


def test_an_error_leaves_the_model_as_it_was_found(model, batch):
    half_trained(model, batch[0])
    before = traces(model)
    for name in METHODS:
        with pytest.raises(RuntimeError, match="out of memory"):
            attack_by(name, exploding(model))(*batch)
        assert_untouched(model, before, name)


@pytest.mark.filterwarnings("ignore:.*torch.jit:FutureWarning")
def test_a_frozen_script_is_attacked(batch):
    script = torch.jit.script(nn.Sequential(nn.Flatten(), nn.Linear(768, 5)).eval())
    plain, frozen = (
        PGD(m, steps=1)(*batch, generator=seeded()) for m in (script, torch.jit.freeze(script))
    )
    assert torch.equal(plain.images, frozen.images)


@pytest.mark.parametrize("context", [torch.no_grad, torch.inference_mode])
def test_attacks_work_where_gradients_are_off(context, model, batch):
    with context():
        images, labels = (t.clone() for t in batch)
        for name in ("ma", "ma apgd", "ma eot", "ma photo", "ma pose", "pgd", "cw", "square"):
            result = attack_by(name, model, 1)(images, labels)
            assert result.noise.any() != (name in ("cw", "ma pose")), name  # CW needs more steps


def test_another_seed_gives_another_result(model, batch):
    attack = MoireAttack(model, scene=SCENE, eps=EPS, steps=2, random_start=1.0)
    one, same, other = (attack(*batch, generator=seeded(s)).images for s in (1, 1, 2))
    assert torch.equal(one, same) and not torch.equal(one, other)


def test_adversarial_moire_in_a_collate(model, batch):
    adversarial = AdversarialMoire(model, scene=SCENE, eps=EPS, steps=1)
    collate = torch.utils.data.default_collate
    loader = torch.utils.data.DataLoader(
        torch.utils.data.TensorDataset(*batch), 3, collate_fn=lambda b: adversarial(*collate(b))
    )
    shown = torch.cat([x for x, _ in loader])
    assert shown.shape == batch[0].shape and not torch.equal(shown, batch[0])
    assert list(adversarial.parameters()) == []  # the model is not a part of it
    untouched, _ = AdversarialMoire(model, scene=SCENE, p=0.0)(*batch)
    assert torch.equal(untouched, batch[0])


def test_normalized_puts_the_normalisation_inside(model, batch):
    mean, std = (0.4, 0.5, 0.6), (0.2, 0.3, 0.4)
    m, s = torch.tensor(mean).view(3, 1, 1), torch.tensor(std).view(3, 1, 1)
    model.eval()
    assert torch.allclose(Normalized(model, mean, std)(batch[0]), model((batch[0] - m) / s))
    assert set(Normalized(model).state_dict()) == {f"model.{k}" for k in model.state_dict()}


def test_saturated_and_black_pixels_are_reached(model):
    """A white screen that overexposes, and a black one under read noise."""
    scene = Scene(lens=Lens(blur=3.0), sensor=Sensor(gain=4.0, read_noise=0.01))
    for level in (0.0, 1.0):
        images = torch.full((2, 3, 12, 12), level)
        result = MoireAttack(model, scene=scene, eps=EPS, steps=1)(images, torch.tensor([0, 1]))
        inward = result.noise if level == 0 else -result.noise
        assert (inward > 0).float().mean() > 0.2
        assert not torch.equal(result.images, capture(images, result.shot))


def test_noise_on_a_reading_stays_where_it_changes_the_photo():
    """A dark reading goes below 0 only where demosaicing mixes it: elsewhere without a gradient."""

    def darkness(x):
        return torch.stack([x.mean((1, 2, 3)), 0 * x[:, 0, 0, 0] + 0.5], 1)

    images = torch.full((1, 3, 8, 8), 0.08)
    for settings, is_bounded in (({"cfa": "none"}, True), ({"bits": 3}, True), ({}, False)):
        scene = Scene(panel=Panel(layout="even"), sensor=Sensor(scale=2.0, **settings))
        result = MoireAttack(darkness, scene=scene, eps=0.1, steps=1)(images, torch.tensor([0]))
        lowest = (expose(images, result.shot) + result.noise).min()
        assert result.noise.min() < -0.05 and (lowest >= 0) == is_bounded, settings


def test_half_precision_models_are_attacked(model, batch):
    images, labels = batch[0].bfloat16(), batch[1]
    for attack in (
        MoireAttack(Normalized(model.bfloat16()), scene=SCENE, eps=EPS, steps=2),
        PGD(model, eps=EPS, steps=2),
    ):
        result = attack(images, labels)
        assert result.images.dtype == torch.bfloat16 and result.noise.abs().max() > 0


def test_n_fgsm_may_leave_the_ball(model, batch):
    attack = MoireAttack(model, scene=SCENE, eps=EPS, steps=1, step_size=1.0, random_start=2.0)
    assert EPS < attack(*batch).noise.abs().max() <= 3 * EPS * (1 + 1e-6)


def test_unread_sensor_pixels_get_no_noise(model, batch):
    """paper_code reads 3 x 3 pixels around a centre; elsewhere the gradient is exactly zero."""
    result = MoireAttack(model, scene="paper_code", eps=EPS, steps=2)(*batch)
    assert result.noise.shape == result.shot.raw_shape()
    assert (result.noise[:, :, 0] == 0).float().mean() > 0.2


def test_a_random_start_has_a_gradient_on_white_pictures():
    """From above 1, where pixels are clipped, none would take its step."""

    def bright(images):
        light = 10 * images.mean((1, 2, 3))
        return torch.stack([light, -light], 1)

    images, labels = torch.ones(4, 3, 8, 8), torch.zeros(4, dtype=torch.int64)
    darkened = PGD(bright, eps=0.1, steps=1).last(images, labels)
    assert torch.allclose(darkened, torch.full_like(images, 0.9))


@pytest.mark.parametrize(
    ("name", "steps"),
    [("pgd", 0), *((name, 2) for name in ("ma", "pgd", "patch", "cw", "square", "toward pgd"))],
)
def test_a_model_may_work_in_place(name, steps, model, batch):
    model.eval()
    plain, in_place = (
        attack_by(name, one, steps)(*batch, generator=seeded())
        for one in (lambda x: model(x - 0.5), lambda x: model(x.sub_(0.5)))
    )
    for part in ("images", "success", "noise", "loss"):
        assert torch.equal(getattr(plain, part), getattr(in_place, part)), part


@pytest.mark.parametrize("name", ["pgd", "patch", "ma", "ma photo", "ma turned", "ma eot"])
def test_a_subset_of_a_problem_renders_its_own_rows(name, model, batch):
    images, _ = batch
    rows = torch.tensor([4, 1])
    attack = attack_by(name, model)
    problem = attack.problem(images, attack.draw(images, None, seeded()), seeded())
    point = problem.start(0.1, seeded(1), random_pose=True)
    subset = problem.subset(rows)
    own_point = {name: x[rows] for name, x in point.items()}
    assert torch.equal(subset.render(own_point), problem.render(point)[rows])
    assert subset.shape == (2, *problem.shape[1:])
    assert not torch.equal(problem.render(point), problem.render(problem.clean_point()))
    assert len(problem.forward_views(point)) == problem.views * len(images)
    shot = problem.shot_of(point)
    if shot is not None:
        numbers = subset.shot_of(own_point).numbers()
        for key, values in shot.numbers().items():
            assert torch.equal(numbers[key], values[rows])
