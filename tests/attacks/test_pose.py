"""The adversary turns the camera: poses stay in range, serve it as well as drawn ones, replay."""

import dataclasses

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, attacks, capture
from moireaug.attacks import MoireAttack
from moireaug.attacks.camera import pose_of, searched_fields, shot_at_pose
from moireaug.mixtures import as_scenes
from moireaug.scene.fields import bounds
from moireaug.scene.parts import PARTS
from tests.attacks.common import EPS, refusal

SCENE = Scene(
    panel=Panel(scale=(0.9, 1.2)),
    view=View(yaw=(-8.0, 8.0), roll=(-5.0, 5.0), zoom=(0.95, 1.0)),
    lens=Lens(blur=(0.25, 0.5), k1=(-0.02, 0.02)),
    sensor=Sensor(scale=2.0, gain=(1.8, 2.6), read_noise=(0.0, 0.01)),
    develop=Develop(brighten=(0.0, 0.05), jpeg=(0.0, 0.0)),
)
BOX = dataclasses.replace(SCENE, sensor=dataclasses.replace(SCENE.sensor, exposure="box"))
ALL = ("noise", *PARTS)
TABLE = {
    "view": (SCENE, {"optimise": ("view",)}),
    "view apgd": (SCENE, {"optimise": ("view",), "rule": "apgd"}),
    "view restarts": (SCENE, {"optimise": ("view",), "restarts": 3}),
    "all": (SCENE, {"optimise": ALL}),
    "all of the box": (BOX, {"optimise": ALL}),
    "all in expectation": (SCENE, {"optimise": ALL, "eot": 2}),
    "camera at the photo": (SCENE, {"optimise": ("noise", "sensor", "lens"), "noise_at": "photo"}),
    "develop": (SCENE, {"optimise": ("develop", "panel")}),
}


@pytest.fixture
def small(batch):
    return batch[0][..., :8, :8], batch[1]


def fields_of(shot):
    return {(p, k): getattr(getattr(shot, p), k) for p in PARTS for k in getattr(shot, p).ranged}


@pytest.mark.parametrize(("name", "targeted"), [*((name, False) for name in TABLE), ("all", True)])
def test_a_found_pose_is_what_it_says(name, targeted, model, small):
    scene, settings = TABLE[name]
    (images, labels), model = small, model.eval()
    shot = scene.sample(6, (8, 8), torch.Generator().manual_seed(0))
    attack = MoireAttack(model, scene=scene, eps=2 / 255, steps=3, **settings)
    targets = (labels + 1) % 5 if targeted else None
    result = attack(images, labels, targets, shot=shot, generator=torch.Generator().manual_seed(1))
    drawn, found = fields_of(shot), fields_of(result.shot)
    for (part, k), value in found.items():
        low, high = bounds(getattr(getattr(scene, part), k))
        assert value.shape == (6,) and not value.requires_grad
        assert ((value >= low) & (value <= high)).all()
        if part not in attack.optimise or low == high:
            assert torch.equal(value, drawn[part, k]), (part, k)
    assert any(not torch.equal(value, drawn[key]) for key, value in found.items())
    assert torch.equal(result.shot.seed, shot.seed)
    assert result.noise.any() == ("noise" in attack.optimise)
    if attack.noise_at == "photo":
        replayed = (capture(images, result.shot) + result.noise).clamp(0, 1)
    else:
        assert result.noise.shape == shot.raw_shape()
        replayed = capture(images, result.shot, result.noise)
    assert torch.allclose(replayed, result.images, atol=1e-6)
    if attack.eot == 1:  # with more, other shots have judged it
        with torch.no_grad():
            goal, sign = (labels, 1) if targets is None else (targets, -1)
            before, after = (
                sign * attacks.margin(model(x), goal)
                for x in (capture(images, shot), result.images)
            )
        assert (after >= before - 1e-5).all() and after.mean() > before.mean() + 1e-3


def test_brightness_goes_to_its_end():
    """A closed form: a model that rewards brightness gets the greatest gain and brighten."""
    scene = Scene(
        sensor=Sensor(gain=(1.0, 2.0)), lens=Lens(blur=0.5), develop=Develop(brighten=(-0.1, 0.1))
    )

    def model(x):
        return torch.stack([-x.mean((1, 2, 3)), x.mean((1, 2, 3))], 1)

    for rule in ("sign", "momentum", "apgd"):
        attack = MoireAttack(model, scene=scene, steps=8, optimise=("sensor", "develop"), rule=rule)
        result = attack(torch.full((3, 3, 8, 8), 0.4), torch.zeros(3, dtype=torch.long))
        assert result.shot.sensor.gain.tolist() == [2.0] * 3
        assert result.shot.develop.brighten.tolist() == [0.1] * 3


def test_what_no_effect_reads_stays(model, small):
    """The phase of pulses that no shutter sees, and a file's quality, which has no gradient."""
    scene = dataclasses.replace(SCENE, develop=Develop(jpeg=(40.0, 90.0)))
    shot = scene.sample(6, (8, 8))
    attack = MoireAttack(model, scene=scene, steps=2, optimise=("panel", "develop"))
    result = attack(*small, shot=shot)
    assert torch.equal(result.shot.panel.phase, shot.panel.phase)
    assert torch.allclose(result.shot.develop.jpeg, shot.develop.jpeg, atol=1e-12)


@pytest.mark.parametrize("scene", [SCENE, "paper_code", ["screen_photo", "phone_at_laptop"]])
def test_the_worst_of_several_draws_is_attacked(scene, model, small):
    (images, labels), model = small, model.eval()
    scene = as_scenes(scene)
    shot = scene.sample(6, (8, 8), torch.Generator().manual_seed(0))
    margins = []
    for draws in (1, 2, 16):
        attack = MoireAttack(model, scene=scene, eps=0.0, steps=1, draws=draws)
        g = torch.Generator().manual_seed(1)
        result = attack(images, labels, shot=shot, generator=g)
        assert torch.equal(capture(images, result.shot), result.images)
        margins.append(attacks.margin(model(result.images), labels).detach())
        # an image counts as right by the shot that was asked for, not by the worst draw
        natural = model(capture(images, shot))
        assert torch.equal(result.clean_correct, natural.argmax(1) == labels)
    assert torch.allclose(margins[0], attacks.margin(natural, labels), atol=1e-4)
    assert all((found >= margins[0] - 1e-4).all() for found in margins[1:])
    assert margins[2].mean() > max(margins[1].mean(), margins[0].mean() + 1e-3)
    numbers = result.shot.numbers()
    assert any(not torch.equal(drawn, numbers[name]) for name, drawn in shot.numbers().items())
    assert not torch.equal(result.shot.seed, shot.seed)


WIDE = Scene(panel=Panel(width=90.0), view=View(yaw=20.0), sensor=Sensor(pitch=1.5, gain=1.5))


@pytest.mark.parametrize("settings", [{"eot": 2}, {"draws": 4}, {"draws": 2, "noise_at": "photo"}])
def test_draws_for_a_part_of_a_photo_are_of_that_part(settings, model, small):
    """Of a scene without a range, they are the shot itself, at its place in the larger photo."""
    images, labels = small
    part = WIDE.sample(6, (40, 40)).crop(4, 28, 8, 8)
    attack = MoireAttack(model, scene=WIDE, eps=EPS, steps=1, **settings)
    problem = attack.problem(images, part, torch.Generator().manual_seed(0))
    photos = problem.render(problem.clean_point())
    assert torch.equal(photos, capture(images, part))
    views = problem.forward_views(problem.clean_point())
    assert torch.allclose(views, photos.repeat(attack.eot, 1, 1, 1), atol=1e-6)
    drawn = problem.drawn_again()
    assert torch.allclose(drawn.render(drawn.clean_point()), photos, atol=1e-6)
    result = attack(images, labels, shot=part)
    assert result.shot.part_of == part.part_of


def test_fresh_draws_are_where_the_shot_is(model, small):
    """Images on a GPU are attacked by a shot on the CPU, with which its rivals are compared."""
    images, _ = small
    attack = MoireAttack(model, scene=SCENE, eps=EPS, draws=2)
    problem = attack.problem(images, SCENE.sample(6, (8, 8)), None)
    elsewhere = dataclasses.replace(problem, images=images.to("meta"))
    assert elsewhere._fresh_shots(6).device == problem.shot.device


def test_draws_are_at_least_one_and_of_a_known_shot(model):
    assert "draws must be" in refusal(lambda: MoireAttack(model, draws=0))
    assert "set one of them to 1" in refusal(lambda: MoireAttack(model, draws=2, eot=2))


def test_a_pose_and_its_shot_are_inverse():
    shot = SCENE.sample(5, (8, 8))
    fields = searched_fields(SCENE, ALL)
    assert len(fields) == 9
    pose = pose_of(shot, fields)
    assert pose.shape == (5, 9) and pose.abs().max() <= 1
    for key, value in fields_of(shot_at_pose(shot, fields, pose)).items():
        assert torch.allclose(value, fields_of(shot)[key], rtol=1e-12)
    for end in (-1.0, 1.0):  # a gradient at the ends, too
        pose = torch.full((5, 9), end, dtype=torch.float64, requires_grad=True)
        turned = shot_at_pose(shot, fields, pose)
        assert turned.view.yaw.tolist() == [8.0 * end] * 5
        (gradient,) = torch.autograd.grad(turned.view.yaw.sum(), pose)
        assert gradient.sum() == 5 * 8.0


def test_one_generator_one_pose(model, small):
    attack = MoireAttack(model, scene=SCENE, steps=1, optimise=("noise", "view"), restarts=2)
    runs = [attack(*small, generator=torch.Generator().manual_seed(s)).images for s in (1, 1, 2)]
    assert torch.equal(runs[0], runs[1]) and not torch.equal(runs[0], runs[2])
    assert torch.equal(
        *(attack.last(*small, generator=torch.Generator().manual_seed(1)) for _ in range(2))
    )


def test_the_phase_of_a_flicker_that_shows_is_moved():
    scene = Scene(panel=Panel(pwm=240.0), sensor=Sensor(shutter=1 / 500))
    assert searched_fields(scene, ("panel",)) == ["panel.phase"]


STILL = Scene(view=View(roll=3.0))
POINT = Scene(view=View(roll=(0.0, 3.0)), sensor=Sensor(exposure="point"))
BAD = [
    ({"scene": "paper", "optimise": ("view",)}, "Set Sensor(exposure='spectral')"),
    ({"scene": "paper_code", "optimise": ("view",)}, "set pose='camera'"),
    ({"scene": STILL, "optimise": ("view",)}, "optimise names 'view', which has no range"),
    ({"scene": STILL, "optimise": ("panel",)}, "optimise names 'panel', which has no range"),
    ({"scene": SCENE, "optimise": ("noise", "views")}, "Did you mean 'view'?"),
    ({"scene": SCENE, "optimise": "view"}, "tuple of different names"),
    ({"scene": SCENE, "optimise": ()}, "tuple of different names"),
    ({"scene": SCENE, "optimise": ("view", "view")}, "tuple of different names"),
]


def test_what_cannot_be_turned_is_refused(model, small):
    for settings, sentence in BAD:
        assert sentence in refusal(lambda settings=settings: MoireAttack(model, **settings))
    attack, shot = MoireAttack(model, scene=SCENE, optimise=("view",)), POINT.sample(6, (8, 8))
    assert "differentiable in the shot" in refusal(lambda: attack(*small, shot=shot))
