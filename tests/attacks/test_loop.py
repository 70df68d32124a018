"""Every attack: what a result says, closed forms, models broken by construction, hard input, and leaving no trace."""

import math

import pytest
import torch
from torch import nn

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, attacks, capture, expose
from moireaug.attacks import ATTACKS, BIM, CW, MIFGSM, PGD, RULES, MoireAttack, Normalized, SquareMoire
from moireaug.effects.tone import clip
from moireaug.transforms import AdversarialMoire

SCENE = Scene(
    panel=Panel(scale=1.1), view=View(roll=(-5, 5)), lens=Lens(blur=0.25), sensor=Sensor(scale=2.0, gain=2.0),
    develop=Develop(brighten=0.1),
)  # fmt: skip
EPS = 4 / 255


def predicted(model, images):
    with attacks.evaluating(model), torch.no_grad():
        return model(images).argmax(1)


METHODS = {
    "ma": lambda m, **k: MoireAttack(model=m, scene=SCENE, **k),
    "ma margin": lambda m, **k: MoireAttack(model=m, scene=SCENE, loss="margin", **k),
    "ma restarts": lambda m, **k: MoireAttack(model=m, scene=SCENE, restarts=2, random_start=1.0, **k),
    "ma eot": lambda m, **k: MoireAttack(model=m, scene=SCENE, eot=2, **k),
    "ma paper_code": lambda m, **k: MoireAttack(model=m, scene="paper_code", **k),
    "ma dlr": lambda m, **k: MoireAttack(model=m, scene=SCENE, loss="dlr", **k),
    "ma momentum": lambda m, **k: MoireAttack(model=m, scene=SCENE, rule="momentum", **k),
    "ma halving": lambda m, **k: MoireAttack(model=m, scene=SCENE, rule="halving", restarts=2, **k),
    "ma printed": lambda m, **k: MoireAttack(model=m, scene=SCENE, rule="printed", **k),
    "ma photo": lambda m, **k: MoireAttack(model=m, scene=SCENE, noise_at="photo", **k),
    "ma turned": lambda m, **k: MoireAttack(model=m, scene=SCENE, optimise=("noise", "view"), **k),
    "ma pose": lambda m, **k: MoireAttack(model=m, scene=SCENE, optimise=("view",), rule="halving", **k),
    "pgd": lambda m, **k: PGD(model=m, **k),
    "pgd margin": lambda m, **k: PGD(model=m, loss="margin", **k),
    "bim": lambda m, **k: BIM(model=m, **k),
    "mifgsm": lambda m, **k: MIFGSM(model=m, **k),
    "cw": lambda m, eps, **k: CW(model=m, **k),
    "square": lambda m, **k: SquareMoire(model=m, scene=SCENE, **k),
    "square photo": lambda m, **k: SquareMoire(model=m, scene=SCENE, noise_at="photo", **k),
}
EXCEEDS = {"ma printed": 2.0, "cw": math.inf}  # by how much the noise may exceed eps in three steps


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("targeted", [False, True])
def test_a_result_is_what_it_says(name, targeted, model, batch):
    images, labels = batch
    targets = (labels + 1) % 5 if targeted else None
    kept = images.clone()
    result = METHODS[name](model, eps=EPS, steps=3)(images, labels, targets)
    assert torch.equal(images, kept)
    assert result.images.shape == images.shape and result.images.min() >= 0 and result.images.max() <= 1
    assert result.noise.abs().max() <= EPS * EXCEEDS.get(name, 1.0) * (1 + 1e-5)
    assert result.loss.shape == (3,) and result.eps == (result.noise.abs().max() if name == "cw" else EPS)
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
    result = METHODS[name](model, eps=EPS, steps=2)(torch.rand(n, 3, 8, 8), torch.zeros(n, dtype=torch.long))
    assert result.images.shape == (n, 3, 8, 8) and len(result.success) == len(result.noise) == n


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_saturated_logits_on_flat_images(name, level, model):
    images, labels = torch.full((2, 3, 8, 8), level), torch.tensor([0, 1])
    result = METHODS[name](lambda x: model(x) * 1e4, eps=EPS, steps=3)(images, labels)
    assert result.images.isfinite().all() and result.noise.isfinite().all() and result.loss.isfinite().all()
    assert result.images.min() >= 0 and result.images.max() <= 1


class Linear(nn.Module):
    """Logits linear in the photo: the worst noise of a ball is known in closed form."""

    def __init__(self, size):
        super().__init__()
        g = torch.Generator().manual_seed(9)
        self.weight = nn.Parameter(torch.randn(2, 3 * size * size, generator=g, dtype=torch.float64))

    def forward(self, x):
        return x.flatten(1) @ self.weight.T.to(x)


@pytest.mark.parametrize("rule", ["sign", "momentum", "halving"])
@pytest.mark.parametrize("loss", ["ce", "margin"])
@pytest.mark.parametrize("steps", [1, 5])
def test_a_linear_model_is_attacked_optimally(loss, steps, rule):
    """margin(delta) - margin(0) = eps * ||A^T w||_1, reached exactly, as long as nothing is clipped."""
    scene = Scene(
        panel=Panel(scale=1.1),
        view=View(roll=3.0),
        lens=Lens(blur=0.3),
        sensor=Sensor(scale=2.0),
        develop=Develop(brighten=0.2),
    )
    images = torch.rand(3, 3, 8, 8, dtype=torch.float64) * 0.5 + 0.3
    model, labels = Linear(8), torch.tensor([0, 1, 0])
    shot = scene.sample(3, (8, 8))
    noise = torch.zeros(shot.raw_shape(), dtype=torch.float64, requires_grad=True)
    before = attacks.margin(model(capture(images, shot, noise)), labels)
    (slope,) = torch.autograd.grad(before.sum(), noise)
    best = before + EPS * slope.abs().sum((1, 2, 3))
    result = MoireAttack(model=model, scene=scene, eps=EPS, steps=steps, loss=loss, rule=rule)(
        images, labels, shot=shot
    )
    reached = attacks.margin(model(result.images), labels)
    assert torch.allclose(reached, best, rtol=1e-9)
    assert (reached > before + 1e-3).all()


def test_a_model_broken_by_construction_is_broken():
    """Its decision hangs on a difference far below eps: an attack that cannot flip it is a broken attack."""

    class Fragile(nn.Module):
        def forward(self, x):
            left, right = x[..., :8].mean((1, 2, 3)), x[..., 8:].mean((1, 2, 3))
            return torch.stack([left, right], 1) * 1e4

    images = torch.full((8, 3, 16, 16), 0.5)
    images[:4, ..., :8] += 0.002
    images[4:, ..., 8:] += 0.002
    model = Fragile()
    scene = Scene(lens=Lens(blur=2.0), sensor=Sensor(scale=2.0, gain=3.0))
    labels = predicted(model, scene.capture(images))
    assert labels.tolist() == [0] * 4 + [1] * 4
    settings = [{"rule": rule, "loss": loss} for rule in RULES for loss in ("ce", "margin")] + [{"noise_at": "photo"}]
    for setting in settings:
        attack = MoireAttack(model=model, scene=scene, eps=EPS, steps=5, **setting)
        for targets in (None, 1 - labels):
            assert attack(images, labels, targets).success.all(), setting
    # and what it cannot reach, it does not claim
    assert not MoireAttack(model=model, scene=scene, eps=1e-7, steps=5)(images, labels).success.any()


class Brightness(nn.Module):
    """Three classes, by the mean of the image and how far it lies from what it was trained on."""

    def forward(self, x):
        x = (x.mean((1, 2, 3)) - 0.5) * 100
        return torch.stack([x, -x, -x.abs() - 9], 1)


class OnePixel(nn.Module):
    def forward(self, x):
        x = (x[:, 1, 4, 4] - 0.5) * 10
        return torch.stack([x, -x, -x.abs() - 9], 1)


@pytest.mark.parametrize("name", ATTACKS)
@pytest.mark.parametrize("broken", [Brightness, OnePixel])
@pytest.mark.parametrize("targeted", [False, True])
def test_every_attack_breaks_what_is_broken(name, broken, targeted):
    """Decisions that hang on one number, which eps moves far enough; gradient or none, each attack must find it."""
    images = torch.tensor([0.498, 0.502]).view(2, 1, 1, 1).expand(2, 3, 8, 8).clone()
    labels, settings = torch.tensor([1, 0]), {"steps": 20}
    if name != "cw":
        settings["eps"] = 0.03
    if issubclass(ATTACKS[name], MoireAttack):
        # a camera whose photo is the image
        settings["scene"] = Scene(sensor=Sensor(cfa="none", exposure="mean", gain=3.0))
        assert torch.equal(predicted(broken(), settings["scene"].capture(images)), labels)
    assert torch.equal(predicted(broken(), images), labels)
    result = ATTACKS[name](broken(), **settings)(images, labels, 1 - labels if targeted else None)
    assert result.success.all()


def test_the_attack_beats_random_noise(trained):
    g = torch.Generator().manual_seed(0)
    images = torch.rand(64, 3, 16, 16, generator=g)
    labels = torch.arange(64) % 5
    images[torch.arange(64), 0, :, labels * 3] *= 0.3  # the class is where a column is dark
    shot = SCENE.sample(len(images), (16, 16))
    model = trained(capture(images, shot), labels)
    signs = torch.randint(0, 2, shot.raw_shape(), generator=g) * 2.0 - 1
    result = MoireAttack(model=model, scene=SCENE, eps=EPS, steps=10)(images, labels, shot=shot)
    fooled = (predicted(model, capture(images, shot, EPS * signs)) != labels).float().mean()
    assert result.success.float().mean() > fooled + 0.2
    assert result.loss[-1] > result.loss[0]


def test_more_eps_never_fools_fewer(trained):
    g = torch.Generator().manual_seed(0)
    images, labels = torch.rand(40, 3, 16, 16, generator=g), torch.arange(40) % 5
    shot = SCENE.sample(len(images), (16, 16))
    model = trained(capture(images, shot), labels)
    curve = MoireAttack(model=model, scene=SCENE, eps=[0, 2 / 255, 8 / 255, 1.0], steps=10)(images, labels, shot=shot)
    rates = [r.success.float().mean().item() for r in curve]
    assert [r.eps for r in curve] == [0, 2 / 255, 8 / 255, 1.0]
    assert rates == sorted(rates) and rates[-1] == 1.0
    assert torch.allclose(curve[0].images, capture(images, shot), atol=1e-6)


def test_restarts_are_no_worse(model, batch):
    images, labels = batch
    shot = SCENE.sample(6, (16, 16))
    margins = []
    for restarts in (1, 4):
        result = MoireAttack(model=model, scene=SCENE, eps=EPS, steps=2, restarts=restarts)(images, labels, shot=shot)
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
    modes, flags = [m.training for m in model.modules()], [p.requires_grad for p in model.parameters()]
    attack = METHODS[name](Explodes(model, after), eps=EPS, steps=2)
    if after == 1:
        with pytest.raises(RuntimeError, match="out of memory"):
            attack(images, labels)
    else:
        attack(images, labels)
    assert all(torch.equal(v, model.state_dict()[k]) for k, v in state.items())
    assert all(torch.equal(p.grad, g) for p, g in zip(model.parameters(), grads, strict=True))
    assert [m.training for m in model.modules()] == modes
    assert [p.requires_grad for p in model.parameters()] == flags


@pytest.mark.parametrize("context", [torch.no_grad, torch.inference_mode])
def test_attacks_work_where_gradients_are_off(context, model, batch):
    with context():
        images, labels = (t.clone() for t in batch)
        for name in METHODS:
            result = METHODS[name](model, eps=EPS, steps=2)(images, labels)
            assert result.noise.any() != (name in ("cw", "ma pose"))  # two steps do not bring CW to its goal


def test_one_generator_one_result(model, batch):
    attack = MoireAttack(model=model, scene=SCENE, eps=EPS, steps=2, random_start=1.0)
    runs = [attack(*batch, generator=torch.Generator().manual_seed(s)).images for s in (1, 1, 2)]
    assert torch.equal(runs[0], runs[1]) and not torch.equal(runs[0], runs[2])


BAD = [
    (lambda m, x, y: MoireAttack(model=m, eps=-0.1), "eps must be a number >= 0"),
    (lambda m, x, y: MoireAttack(model=m, eps=math.nan), "eps must be a number >= 0"),
    (lambda m, x, y: MoireAttack(model=m, eps=[]), "eps must be a number >= 0"),
    (lambda m, x, y: MoireAttack(model=m, eps=4), "Divide by 255?"),
    (lambda m, x, y: MoireAttack(model=m, steps=-1), "steps must be an integer >= 0"),
    (lambda m, x, y: MoireAttack(model=m, restarts=0), "restarts must be an integer >= 1"),
    (lambda m, x, y: MoireAttack(model=m, eot=0), "eot must be an integer >= 1"),
    (lambda m, x, y: MoireAttack(model=m, step_size=0), "step_size must be above 0"),
    (lambda m, x, y: MoireAttack(m, steps=2, random_start=2.0), "for a single step"),
    (lambda m, x, y: MoireAttack(model=m, loss="margins"), "Did you mean 'margin'?"),
    (lambda m, x, y: MoireAttack(model=m, scene="papers"), "Did you mean 'paper'?"),
    (lambda m, x, y: MoireAttack(m, rule="signs"), "Did you mean 'sign'?"),
    (lambda m, x, y: MoireAttack(m, noise_at="raws"), "Did you mean 'raw'?"),
    (lambda m, x, y: MoireAttack(m, rule="printed", eot=2), "needs eot = 1"),
    (lambda m, x, y: MoireAttack(m, scene=SCENE, rule="printed", optimise=("view",)), "'printed' adds to the reading"),
    (lambda m, x, y: PGD(m, rule="printed"), "a pixel attack has none"),
    (lambda m, x, y: PGD(lambda i: m(i)[:, :2], loss="dlr")(x, y * 0), "at least 3 classes; got logits of 2"),
    (lambda m, x, y: SquareMoire(m, rule="momentum"), "no use for rule = 'momentum'"),
    (lambda m, x, y: SquareMoire(m, step_size=0.1), "no use for step_size"),
    (lambda m, x, y: SquareMoire(m, eot=2), "no use for eot"),
    (lambda m, x, y: SquareMoire(m)(x, y + 5), "the model's classes; got"),
    (lambda m, x, y: CW(m, c=0), "c must be a finite number above 0"),
    (lambda m, x, y: CW(m, lr=math.nan), "lr must be a finite number above 0"),
    (lambda m, x, y: CW(m, confidence=-1), "confidence must be"),
    (lambda m, x, y: CW(m, steps=1.5), "steps must be an integer >= 0"),
    (lambda m, x, y: CW(m)(x, y, shot=SCENE.sample(6, (16, 16))), "no camera"),
    (lambda m, x, y: CW(m)(x, y + 5), "the model's classes; got"),
    (lambda m, x, y: CW(m)(x, y[:2]), "shape (6,)"),
    (lambda m, x, y: PGD(model=m)(x, y + 5), "[0, 4], the model's classes; got"),
    (lambda m, x, y: PGD(model=m)(x, y - 9), "class indices >= 0"),
    (lambda m, x, y: PGD(model=m)(x, y.float()), "integer tensor"),
    (lambda m, x, y: PGD(model=m)(x, y[:2]), "shape (6,)"),
    (lambda m, x, y: PGD(model=m)(x, y, y + 7), "the model's classes"),
    (lambda m, x, y: PGD(model=m)(x * 255, y), "lie in [0, 1]"),
    (lambda m, x, y: PGD(model=m)(x, y, shot=SCENE.sample(6, (16, 16))), "no camera"),
    (lambda m, x, y: MoireAttack(model=m)(x, y, shot=SCENE.sample(2, (16, 16))), "drawn for 2 images"),
    (lambda m, x, y: PGD(model=lambda i: i)(x, y), "must return logits (B, K)"),
    (lambda m, x, y: AdversarialMoire(m, p=2), "p must be a probability"),
    (lambda m, x, y: Normalized(m, std=(0.1, 0.0, 0.1)), "positive std"),
]


@pytest.mark.parametrize(("do", "sentence"), BAD, ids=[b[1][:28] for b in BAD])
def test_wrong_input_gets_a_sentence(do, sentence, model, batch):
    with pytest.raises((ValueError, TypeError)) as error:
        do(model, *batch)
    assert sentence in str(error.value)


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
    loader = DataLoader(TensorDataset(*batch), 3, collate_fn=lambda b: adversarial(*default_collate(b)))
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
    """A white screen that overexposes, and a black one under read noise: no site hides from the attack."""
    scene = Scene(lens=Lens(blur=3.0), sensor=Sensor(gain=4.0, read_noise=0.01))
    for level in (0.0, 1.0):
        images = torch.full((2, 3, 12, 12), level)
        result = MoireAttack(model, scene=scene, eps=EPS, steps=1)(images, torch.tensor([0, 1]))
        inward = result.noise if level == 0 else -result.noise
        assert (inward > 0).float().mean() > 0.2
        assert not torch.equal(result.images, capture(images, result.shot))


def test_half_precision_models_are_attacked(model, batch):
    images, labels = batch[0].bfloat16(), batch[1]
    for attack in (MoireAttack(model.bfloat16(), scene=SCENE, eps=EPS, steps=2), PGD(model, eps=EPS, steps=2)):
        result = attack(images, labels)
        assert result.images.dtype == torch.bfloat16 and result.noise.abs().max() > 0


def test_n_fgsm_may_leave_the_ball(model, batch):
    attack = MoireAttack(model, scene=SCENE, eps=EPS, steps=1, step_size=1.0, random_start=2.0)
    assert EPS < attack(*batch).noise.abs().max() <= 3 * EPS * (1 + 1e-6)


def test_unread_sensor_pixels_get_no_noise(model, batch):
    """Where the gradient is exactly zero the noise stays zero: paper_code reads 3 x 3 pixels around a centre."""
    result = MoireAttack(model=model, scene="paper_code", eps=EPS, steps=2)(*batch)
    raw = expose(batch[0], result.shot)
    assert result.noise.shape == raw.shape
    assert (result.noise[:, :, 0] == 0).float().mean() > 0.2
