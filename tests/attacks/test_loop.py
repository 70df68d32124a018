"""Every attack: what a result says, hard input, and leaving no trace."""

import math

import pytest
import torch
from torch import nn

from moireaug import Lens, Panel, Scene, Sensor, attacks, capture, expose
from moireaug.attacks import PGD, MoireAttack, Normalized
from moireaug.numeric import clip
from moireaug.transforms import AdversarialMoire
from tests.attacks.common import EPS, METHODS, SCENE, attack_by, predicted

EXCEEDS = {"ma printed": 2.0, "cw": math.inf}  # by how much the noise may exceed eps in three steps


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("targeted", [False, True])
def test_a_result_is_what_it_says(name, targeted, model, batch):
    images, labels = batch
    targets = (labels + 1) % 5 if targeted else None
    kept = images.clone()
    result = attack_by(name, model, 3)(images, labels, targets)
    assert torch.equal(images, kept)
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


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("n", [0, 1])
def test_batches_of_none_and_one(name, n, model):
    result = attack_by(name, model)(torch.rand(n, 3, 8, 8), torch.zeros(n, dtype=torch.long))
    assert result.images.shape == (n, 3, 8, 8) and len(result.success) == len(result.noise) == n


@pytest.mark.parametrize("name", METHODS)
def test_what_lies_a_little_outside_of_0_and_1_is_clipped_before_the_attack(name, model, batch):
    images, labels = batch
    outside = (images * 1.2 - 0.1).clamp(-0.05, 1.05)
    attack = attack_by(name, model)
    results = []
    for given in (outside, clip(outside)):
        results.append(attack(given, labels, generator=torch.Generator().manual_seed(0)))
    assert torch.equal(results[0].images, results[1].images)
    assert torch.equal(results[0].noise, results[1].noise)


@pytest.mark.parametrize("name", METHODS)
def test_saturated_logits_on_flat_images(name, model):
    levels, labels = torch.tensor([0.0, 0.5, 1.0]).repeat(2), torch.tensor([0, 0, 0, 1, 1, 1])
    images = levels[:, None, None, None] * torch.ones(3, 8, 8)
    result = attack_by(name, lambda x: model(x) * 1e4, 3)(images, labels)
    assert result.images.isfinite().all()
    assert result.noise.isfinite().all()
    assert result.loss.isfinite().all()
    assert result.images.min() >= 0 and result.images.max() <= 1


def test_restarts_are_no_worse(model, batch):
    images, labels = batch
    shot = SCENE.sample(6, (16, 16))
    margins = []
    for restarts in (1, 4):
        result = MoireAttack(model=model, scene=SCENE, eps=EPS, steps=2, restarts=restarts)(
            images, labels, shot=shot
        )
        with attacks.evaluating(model), torch.no_grad():
            margins.append(attacks.margin(model(result.images), labels))
    assert (margins[1] >= margins[0] - 1e-5).all()


class Explodes(nn.Module):
    def __init__(self, inner, after):
        super().__init__()
        self.inner, self.after = inner, after

    def forward(self, x):
        self.after -= 1
        if self.after < 0:
            raise RuntimeError("out of memory")
        return self.inner(x)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("after", [99, 1])
def test_the_model_is_left_as_it_was_found(name, after, model, batch):
    images, labels = batch
    model.train()
    model.net[1].eval()
    model(images).sum().backward()
    state = {k: v.clone() for k, v in model.state_dict().items()}
    grads = [p.grad.clone() for p in model.parameters()]
    modes, flags = (
        [m.training for m in model.modules()],
        [p.requires_grad for p in model.parameters()],
    )
    attack = attack_by(name, Explodes(model, after))
    if after == 1:
        with pytest.raises(RuntimeError, match="out of memory"):
            attack(images, labels)
    else:
        attack(images, labels)
    assert all(torch.equal(v, model.state_dict()[k]) for k, v in state.items())
    assert all(torch.equal(p.grad, g) for p, g in zip(model.parameters(), grads, strict=True))
    assert [m.training for m in model.modules()] == modes
    assert [p.requires_grad for p in model.parameters()] == flags


@pytest.mark.filterwarnings("ignore:.*torch.jit:FutureWarning")
def test_a_frozen_script_is_attacked(batch):
    script = torch.jit.script(nn.Sequential(nn.Flatten(), nn.Linear(768, 5)).eval())
    plain, frozen = (
        PGD(m, steps=1)(*batch, generator=torch.Generator().manual_seed(0))
        for m in (script, torch.jit.freeze(script))
    )
    assert torch.equal(plain.images, frozen.images)


@pytest.mark.parametrize("context", [torch.no_grad, torch.inference_mode])
def test_attacks_work_where_gradients_are_off(context, model, batch):
    with context():
        images, labels = (t.clone() for t in batch)
        for name in METHODS:
            result = attack_by(name, model)(images, labels)
            # two steps do not bring CW to its goal; the photo alone fools this network
            assert result.noise.any() != (name in ("cw", "ma pose", "ma until fooled"))


def test_one_generator_one_result(model, batch):
    attack = MoireAttack(model=model, scene=SCENE, eps=EPS, steps=2, random_start=1.0)
    runs = [attack(*batch, generator=torch.Generator().manual_seed(s)).images for s in (1, 1, 2)]
    assert torch.equal(runs[0], runs[1]) and not torch.equal(runs[0], runs[2])


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8])
def test_adversarial_moire_is_a_batch_transform(dtype, model, batch):
    images, labels = batch
    images = (images * 255).to(torch.uint8) if dtype == torch.uint8 else images
    model.train()
    shown, same = AdversarialMoire(model, scene=SCENE, eps=EPS, steps=2)(images, labels)
    assert shown.dtype == dtype and shown.shape == images.shape and torch.equal(same, labels)
    assert model.training and not torch.equal(shown, images)
    untouched, _ = AdversarialMoire(model, scene=SCENE, p=0.0)(images, labels)
    assert torch.equal(untouched, images)


def test_adversarial_moire_in_a_collate(model, batch):
    from torch.utils.data import DataLoader, TensorDataset, default_collate

    adversarial = AdversarialMoire(model, scene=SCENE, eps=EPS, steps=1)
    loader = DataLoader(
        TensorDataset(*batch), 3, collate_fn=lambda b: adversarial(*default_collate(b))
    )
    shown = torch.cat([x for x, _ in loader])
    assert shown.shape == batch[0].shape and not torch.equal(shown, batch[0])
    assert list(adversarial.parameters()) == []  # the model is not a part of it


def test_normalized_puts_the_normalisation_inside(model, batch):
    mean, std = (0.4, 0.5, 0.6), (0.2, 0.3, 0.4)
    m, s = torch.tensor(mean).view(3, 1, 1), torch.tensor(std).view(3, 1, 1)
    model.eval()
    assert torch.allclose(Normalized(model, mean, std)(batch[0]), model((batch[0] - m) / s))
    assert set(Normalized(model).state_dict()) == {f"model.{k}" for k in model.state_dict()}


def test_saturated_and_black_pixels_are_reached(model):
    """A white screen that overexposes, and a black one under read noise: the attack reaches
    every site."""
    scene = Scene(lens=Lens(blur=3.0), sensor=Sensor(gain=4.0, read_noise=0.01))
    for level in (0.0, 1.0):
        images = torch.full((2, 3, 12, 12), level)
        result = MoireAttack(model, scene=scene, eps=EPS, steps=1)(images, torch.tensor([0, 1]))
        inward = result.noise if level == 0 else -result.noise
        assert (inward > 0).float().mean() > 0.2
        assert not torch.equal(result.images, capture(images, result.shot))


@pytest.mark.parametrize(
    ("settings", "is_bounded"),
    [({"cfa": "none"}, True), ({"bits": 3}, True), ({}, False)],
)
def test_noise_on_a_reading_stays_where_it_changes_the_photo(settings, is_bounded):
    """A dark reading that is made darker goes below 0 only where demosaicing mixes it: elsewhere it
    would have no gradient to come back by."""

    def darkness(x):
        return torch.stack([x.mean((1, 2, 3)), 0 * x[:, 0, 0, 0] + 0.5], 1)

    scene = Scene(panel=Panel(layout="even"), sensor=Sensor(scale=2.0, **settings))
    images = torch.full((1, 3, 8, 8), 0.08)
    result = MoireAttack(darkness, scene=scene, eps=0.1, steps=1)(images, torch.tensor([0]))
    lowest = (expose(images, result.shot) + result.noise).min()
    assert result.noise.min() < -0.05 and (lowest >= 0) == is_bounded


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
    """Where the gradient is exactly zero the noise stays zero: paper_code reads 3 x 3 pixels around
    a centre."""
    result = MoireAttack(model=model, scene="paper_code", eps=EPS, steps=2)(*batch)
    raw = expose(batch[0], result.shot)
    assert result.noise.shape == raw.shape
    assert (result.noise[:, :, 0] == 0).float().mean() > 0.2


def test_a_random_start_has_a_gradient_on_white_pictures():
    """From above 1, where pixels are clipped, none would take its step."""

    class Bright(nn.Module):
        def forward(self, images):
            light = 10 * images.mean((1, 2, 3))
            return torch.stack([light, -light], 1)

    images, labels = torch.ones(4, 3, 8, 8), torch.zeros(4, dtype=torch.int64)
    darkened = PGD(Bright(), eps=0.1, steps=1).last(images, labels)
    assert torch.allclose(darkened, torch.full_like(images, 0.9))
