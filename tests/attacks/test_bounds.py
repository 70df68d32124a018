"""What eps counts: boxes against the sRGB curve in float64, and no reading that leaves its own."""

import dataclasses

import numpy as np
import pytest
import torch

from moireaug import Develop, Scene, attacks, capture, expose
from moireaug.attacks import LOSSES, MoireAttack, MultiTargeted, SquareMoire
from moireaug.attacks.bounds import Bound
from moireaug.attacks.rules import RULES
from moireaug.evaluation.visibility import psnr
from moireaug.mixtures import as_scenes
from moireaug.transforms import AdversarialMoire
from moireaug.transforms import albumentations as for_albumentations
from tests.attacks.common import EPS, SCENE, predicted, refusal
from tests.attacks.test_pose import SCENE as TURNABLE


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def decode(code):
    """The sRGB curve of IEC 61966-2-1, straight below 0, in float64."""
    return np.where(code <= 0.04045, code / 12.92, ((np.maximum(code, 0) + 0.055) / 1.055) ** 2.4)


def encode(light):
    power = 1.055 * np.maximum(light, 0) ** (1 / 2.4) - 0.055
    return np.where(light <= 0.0031308, light * 12.92, power)


def ends(clean, eps):
    """(low, high) of the box of each value of a clean reading."""
    codes = encode(clean.double().numpy())
    return decode(codes - eps), decode(codes + eps)


def test_black_grey_and_white_have_the_boxes_of_the_curve():
    """Black goes as far down as up, by eps / 12.92; white less far down than a hair above."""
    eps = 4 / 255
    reading = torch.tensor([0.0, decode(np.array(0.5)).item(), 1.0], dtype=torch.float64)
    box = Bound(eps, is_light=True).box(reading)
    up, down = (box.noise(torch.full_like(reading, x)) for x in (eps, -eps))
    expected_up = [eps / 12.92, ((0.555 + eps) / 1.055) ** 2.4 - (0.555 / 1.055) ** 2.4]
    expected_up.append(((1.055 + eps) / 1.055) ** 2.4 - 1)
    expected_down = [-eps / 12.92, ((0.555 - eps) / 1.055) ** 2.4 - (0.555 / 1.055) ** 2.4]
    expected_down.append(((1.055 - eps) / 1.055) ** 2.4 - 1)
    assert np.allclose(up, expected_up, rtol=1e-9) and np.allclose(down, expected_down, rtol=1e-9)
    assert up[0] == -down[0] and up[2] > -down[2] > up[1] > 10 * up[0]
    light = Bound(eps, "light", is_light=True).box(reading)
    codes = Bound(eps, "codes", is_light=False).box(reading)
    for same in (light, codes, Bound(0.0, is_light=True).box(reading)):
        assert same.noise(reading) is reading and same.variable(reading) is reading


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("eps", [1e-6, 1 / 255, 8 / 255, 1.0])
def test_a_box_is_the_curves_and_rounding_leaves_none(dtype, eps):
    """Over all of [-0.1, 1.2]; the ends are reached but for some digits."""
    clean = torch.cat([torch.linspace(-0.1, 1.2, 20001), torch.tensor([0.0, 1.0])]).to(dtype)
    box, (low, high) = Bound(eps, is_light=True).box(clean), ends(clean, eps)
    width = high - low
    for x in torch.linspace(-eps, eps, 5, dtype=dtype):
        reading = (clean + box.noise(torch.full_like(clean, x))).double().numpy()
        assert (reading >= low).all() and (reading <= high).all()
    for x, end in ((eps, high), (-eps, low)):
        reached = (clean + box.noise(torch.full_like(clean, x))).double().numpy()
        digits = 40 * torch.finfo(dtype).eps * np.maximum(np.abs(end), np.abs(clean.numpy()))
        assert (np.abs(reached - end) <= 1e-5 * width + digits).all()
    x = torch.linspace(-eps, eps, len(clean), dtype=dtype)
    wide = width > 1e-4 * eps
    back = box.variable(box.noise(x))
    assert torch.allclose(back[wide], x[wide], rtol=1e-5, atol=0)
    assert (back.abs() <= x.abs() * (1 + 1e-7)).all()


def test_a_box_has_the_slope_in_the_reading_that_a_search_of_the_pose_needs():
    reading = torch.tensor([0.001, 0.02, 0.3, 0.9], dtype=torch.float64, requires_grad=True)
    variable = torch.tensor([0.01, -0.02, 0.015, -0.005], dtype=torch.float64)
    variable.requires_grad_()
    bound = Bound(0.02, is_light=True)
    assert torch.autograd.gradcheck(lambda r, x: bound.box(r).noise(x), (reading, variable))


BOXED = {
    "sign": (MoireAttack, {}),
    "sign, restarts": (MoireAttack, {"random_start": 1.0, "restarts": 2}),
    "momentum": (MoireAttack, {"rule": "momentum", "random_start": 1.0}),
    "apgd": (MoireAttack, {"rule": "apgd", "steps": 6}),
    "apgd, until fooled": (MoireAttack, {"rule": "apgd", "until_fooled": True}),
    "eot": (MoireAttack, {"eot": 2}),
    "square": (SquareMoire, {"steps": 6}),
}
SCENES = {
    "binned": Scene.preset("screen_photo"),
    "overexposed": Scene.from_dict({"preset": "screen_photo", "sensor": {"gain": 6.0}}),
    "full": dataclasses.replace(TURNABLE, develop=Develop(linear_light=True)),
}


def assert_boxed(images, shot, noise):
    """No value of the attacked readings leaves its box, and the ends are reached."""
    clean = expose(images, shot)
    low, high = ends(clean, EPS)
    reading, clean = (clean + noise).double().numpy(), clean.double().numpy()
    assert (reading >= low).all() and (reading <= high).all()
    share = (reading - clean) / np.where(reading > clean, high - clean, low - clean)
    assert share.max() > 0.999


@pytest.fixture
def flat_ones(batch):
    """Images of which one is black and one white, and their labels."""
    images = batch[0].clone()
    images[0], images[1] = 0.0, 1.0
    return images, batch[1]


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
@pytest.mark.parametrize("name", BOXED)
def test_no_value_of_a_reading_leaves_its_box(name, scene, model, flat_ones):
    kind, settings = BOXED[name]
    images, _ = flat_ones
    shot = scene.sample(6, (16, 16), seeded())
    labels = predicted(model, capture(images, shot))  # an image that is wrong gets no noise
    attack = kind(model.eval(), **{"scene": scene, "eps": EPS, "steps": 3} | settings)
    for run in (attack, MultiTargeted(attack, targets=2)):
        result = run(images, labels, shot=shot, generator=seeded())
        assert (result.eps, result.bound) == (EPS, "codes")
        assert_boxed(images, result.shot, result.noise)
        assert torch.equal(capture(images, result.shot, result.noise), result.images)


@pytest.mark.parametrize("optimise", [("noise", "view"), ("noise", "panel", "sensor")])
def test_the_box_is_that_of_the_pose_that_was_found(optimise, model, flat_ones):
    images, labels = (x[:3] for x in flat_ones)
    images = images[..., :8, :8]
    scene = SCENES["full"]
    shot = scene.sample(3, (8, 8), seeded())
    attack = MoireAttack(model.eval(), scene=scene, eps=EPS, steps=3, optimise=optimise)
    result = attack(images, labels, shot=shot)
    clean, before = expose(images, result.shot), expose(images, shot)
    assert not torch.allclose(clean, before, atol=1e-4)
    # the box is made of the reading in this call, and its last digits may be of another one's
    low, high = ends(clean, EPS)
    reading = (clean + result.noise).double().numpy()
    assert (reading >= low - 1e-7).all() and (reading <= high + 1e-7).all()


def test_scenes_of_a_mixture_each_have_their_own_boxes(model, flat_ones):
    """Also beside a scene whose readings are codes, where a box is eps."""
    images, labels = flat_ones
    scenes = [SCENES["binned"], SCENE]
    shot = as_scenes(scenes).sample(6, (16, 16), seeded(1))
    result = MoireAttack(model.eval(), scene=scenes, eps=EPS, steps=3)(images, labels, shot=shot)
    assert result.bound == "codes" and len(shot.by_scene()) == 2
    for rows, part in result.shot.by_scene():
        noise = torch.stack([result.noise[row] for row in rows.tolist()])
        if part.scene == SCENE:
            assert noise.abs().max() == pytest.approx(EPS, rel=1e-6)
        else:
            assert_boxed(images[rows], part, noise)


def test_a_single_sign_step_goes_to_the_ends_of_the_boxes(model, batch):
    """Beside the gradient in the reading, by plain torch."""
    images, labels = batch
    shot = SCENES["binned"].sample(6, (16, 16), seeded())
    clean = expose(images, shot).requires_grad_()
    logits = model.eval()(attacks.camera.photo_of_reading(clean, shot))
    (gradient,) = torch.autograd.grad(LOSSES["ce"](logits, labels).sum(), clean)
    low, high = (torch.from_numpy(end) - clean.detach() for end in ends(clean.detach(), EPS))
    expected = torch.where(gradient > 0, high, low) * (gradient != 0)
    noise = MoireAttack(model, eps=EPS, steps=1)(images, labels, shot=shot).noise
    is_free = (clean + expected >= 0) & (clean + expected <= 1)
    assert is_free.float().mean() > 0.9
    assert torch.allclose(noise[is_free].double(), expected[is_free], rtol=1e-3, atol=1e-7)


@pytest.mark.parametrize("rule", RULES)
def test_light_is_the_plain_ball_and_codes_equal_it_without_light(rule, model, batch):
    """Bit for bit: the paper's scenes, and noise on the photo, have one bound under two names."""
    for settings in ({"scene": SCENE}, {"scene": "paper"}, {"noise_at": "photo"}):
        one, other = (
            MoireAttack(model, eps=EPS, steps=3, rule=rule, bound=bound, **settings)(
                *batch, generator=seeded()
            )
            for bound in ("codes", "light")
        )
        assert torch.equal(one.images, other.images) and torch.equal(one.noise, other.noise)
        assert (one.bound, other.bound) == ("codes", "codes" if "noise_at" in settings else "light")
    light = MoireAttack(model, eps=EPS, steps=3, rule=rule, bound="light")(
        *batch, generator=seeded()
    )
    most = 2.0 if rule == "printed" else 1.0
    assert 0.999 * EPS < light.noise.abs().max() <= most * EPS * (1 + 1e-6)


def test_random_starts_steps_and_light_are_the_plain_algorithm(model, batch):
    """Sign steps within eps of light, transcribed: the bound that there was before."""
    images, labels = batch
    shot = SCENES["binned"].sample(6, (16, 16), seeded())
    clean, eps, step = expose(images, shot), 8 / 255, 0.5 * 8 / 255
    delta = torch.empty(clean.shape).uniform_(-eps, eps, generator=seeded(5))
    delta = delta.clamp(-eps, eps)
    for _ in range(3):
        delta.requires_grad_()
        logits = model.eval()(attacks.camera.photo_of_reading(clean + delta, shot))
        (gradient,) = torch.autograd.grad(LOSSES["ce"](logits, labels).sum(), delta)
        delta = (delta.detach() + step * gradient.sign()).clamp(-eps, eps)
    attack = MoireAttack(model, eps=eps, steps=3, step_size=0.5, random_start=1.0, bound="light")
    photos = attack.last(images, labels, shot=shot, generator=seeded(5))
    assert torch.equal(photos, attacks.camera.photo_of_reading(clean + delta, shot))


def test_n_fgsm_and_printed_go_beyond_by_as_many_half_widths(model, flat_ones):
    images, labels = flat_ones
    for settings, most in (
        ({"steps": 1, "step_size": 1.0, "random_start": 2.0}, 3.0),
        ({"steps": 3, "rule": "printed"}, 2.0),
    ):
        attack = MoireAttack(model, eps=EPS, **settings)
        result = attack(images, labels, generator=seeded())
        clean = expose(images, result.shot)
        low, high = ends(clean, EPS)
        half_width = np.where(result.noise > 0, high - clean.numpy(), clean.numpy() - low)
        widths = result.noise.abs().double().numpy() / half_width
        assert 1.2 < widths.max() <= most * (1 + 1e-6), settings
        assert torch.equal(capture(images, result.shot, result.noise), result.images)


def test_values_at_a_clip_stay_where_they_have_a_gradient(model, flat_ones):
    """Without colours to mix, nothing below 0 or above 1 is seen; rounding must not lead there."""
    scene = Scene.from_dict(
        {"preset": "screen_photo", "sensor": {"cfa": "none", "gain": 6.0, "crosstalk": 0.0}}
    )
    scene = dataclasses.replace(scene, develop=Develop(linear_light=True))
    for rule in ("sign", "apgd", "printed"):
        attack = MoireAttack(model, scene=scene, eps=EPS, steps=4, rule=rule, random_start=1.0)
        result = attack(*flat_ones, generator=seeded())
        reading = expose(flat_ones[0], result.shot) + result.noise
        assert reading.min() >= 0 and reading.max() <= 1, rule


def test_codes_are_far_less_visible_than_light(model, batch):
    images, labels = batch
    shot = SCENES["binned"].sample(6, (16, 16), seeded())
    plain, figures = capture(images * 0.4, shot), {}
    for bound in ("codes", "light"):
        attack = MoireAttack(model, eps=EPS, steps=2, bound=bound)
        figures[bound] = psnr(attack(images * 0.4, labels, shot=shot).images, plain).mean()
    assert figures["codes"] > figures["light"] + 5


def test_transforms_pass_the_bound_on(model, batch):
    for bound in ("codes", "light"):
        adversarial = AdversarialMoire(model, eps=EPS, steps=2, bound=bound)
        photos, _ = adversarial(*batch, generator=seeded())
        attack = MoireAttack(model, eps=EPS, steps=2, random_start=1.0, bound=bound)
        g = seeded()
        torch.rand(6, generator=g)  # of p
        assert torch.equal(photos, attack.last(*batch, generator=g))
        assert f"bound='{bound}'" in repr(adversarial)
        one = for_albumentations.AdversarialMoire(model, bound=bound)
        assert one.attack.bound == bound == one.get_transform_init_args()["bound"]
    sentence = "bound must be one of 'codes', 'light'; got 'raw'"
    for kind in (MoireAttack, AdversarialMoire, for_albumentations.AdversarialMoire):
        assert sentence in refusal(lambda kind=kind: kind(model, bound="raw"))
