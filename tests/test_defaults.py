"""No result depends on torch's default dtype or default device: under Lightning's "bf16-true", for
one, every training step runs with another dtype."""

import copy
import dataclasses
import functools
import sys

import albumentations as A
import numpy as np
import pytest
import torch
from kornia.augmentation import AugmentationSequential
from lightning.pytorch.plugins.precision import HalfPrecision
from PIL import Image
from torch import Tensor, nn
from torchvision import tv_tensors

from moireaug import Develop, Lens, Panel, Scene, Sensor, Shot, View, attacks, capture
from moireaug.defenses import DEFENSES, Quilting, restore_mean
from moireaug.engine import backends
from moireaug.evaluation import evaluate
from moireaug.evaluation.visibility import visibility
from moireaug.nn import ScreenCamera
from moireaug.scene.presets import PRESETS
from moireaug.synthesis import screen_in_room
from moireaug.synthesis.pairs import make_pair
from moireaug.transforms import AdversarialMoire, RandomMoire
from moireaug.transforms import albumentations as for_albumentations
from moireaug.transforms import kornia as for_kornia
from tests.defaults import DTYPES, defaults
from training.attack import results
from training.data import signs, splits
from training.demoireing.tiles import tiled
from training.models import classifiers as models
from training.photographs.statistics import measure
from training.suites.corruptions import CORRUPTIONS

SIZE = (16, 20)
IMAGES = torch.rand(2, 3, *SIZE, generator=torch.Generator().manual_seed(1))
LABELS, TARGETS = torch.tensor([0, 2]), torch.tensor([1, 1])
PICTURE = np.random.default_rng(0).integers(0, 256, (40, 48, 3), dtype=np.uint8)
PATCHES = torch.rand(50, 3, 5, 5, generator=torch.Generator().manual_seed(2))
SAMPLE = {
    "image": tv_tensors.Image(IMAGES[0]),
    "mask": tv_tensors.Mask(IMAGES[0, :1] > 0.5),
    "boxes": tv_tensors.BoundingBoxes([[2.0, 3.0, 9.0, 11.0]], format="XYXY", canvas_size=SIZE),
    "points": tv_tensors.KeyPoints([[2.0, 3.0]], canvas_size=SIZE),
    "picture": Image.fromarray(PICTURE),
}
SCENE = Scene(
    view=View(roll=(-5, 5)), lens=Lens(blur=0.3), sensor=Sensor(scale=2.0, read_noise=0.01)
)
CAMERA = dataclasses.replace(SCENE, develop=Develop(registered=False))
ROLLED = Scene(view=View(roll=(-5, 5)), sensor=Sensor(exposure="mean"))
SCENES = {
    **{name: Scene.preset(name) for name in PRESETS},
    "box": Scene(sensor=Sensor(scale=2.0, exposure="box")),
    "supersampled": Scene(sensor=Sensor(exposure="supersample:4")),
    "flickering": Scene(panel=Panel(pwm=240.0), sensor=Sensor(shutter=1e-3, readout=0.01)),
    "flickering crop": Scene.preset("phone_at_dimmed_phone").with_shrink((1, 3)),
    "nlm": Scene(develop=Develop(denoise="nlm", jpeg=80)),
    "bilateral": Scene(sensor=Sensor(scale=2.0), develop=Develop(denoise="bilateral")),
}


def _classifier():
    torch.manual_seed(0)
    pooled = nn.Sequential(nn.Conv2d(3, 6, 3, 2), nn.ReLU(), nn.AdaptiveAvgPool2d(3), nn.Flatten())
    return nn.Sequential(pooled, nn.Linear(54, 4)).eval()


MODEL = _classifier()
MOIRE = functools.partial(attacks.MoireAttack, scene=SCENE, steps=2)
ATTACKS = {
    "ma": MOIRE(MODEL, random_start=1.0, restarts=2),
    "ma at photo": MOIRE(MODEL, noise_at="photo"),
    "ma eot": MOIRE(MODEL, eot=2, rule="apgd", loss="dlr"),
    "ma view": MOIRE(MODEL, scene=ROLLED, steps=1, optimise=("noise", "view")),
    "ma printed": MOIRE(MODEL, rule="printed"),
    "pgd": attacks.PGD(MODEL, steps=2, random_start=1.0),
    "pgd without steps": attacks.PGD(MODEL, steps=0),
    "bim": attacks.BIM(MODEL, steps=2),
    "mifgsm": attacks.MIFGSM(MODEL, steps=2),
    "cw": attacks.CW(MODEL, steps=2),
    "cw without steps": attacks.CW(MODEL, steps=0),
    "patch": attacks.Patch(MODEL, steps=2, area=0.1, random_start=1.0),
    "square": attacks.SquareMoire(MODEL, scene=SCENE, steps=3),
    "multitargeted": attacks.MultiTargeted(attacks.PGD(MODEL, steps=1), targets=2),
    "multitargeted without targets left": attacks.MultiTargeted(attacks.PGD(MODEL, steps=0)),
}
DEFENCES = {
    **DEFENSES,
    "quilting": lambda: Quilting(PATCHES),
    "quilting of images": lambda: Quilting.from_images(IMAGES, patches=20, seed=0),
    "mean restored": lambda: functools.partial(restore_mean, clean=IMAGES.flip(0)),
}


class Source:
    """A picture to make pairs of."""

    def draw(self, rng):
        return "picture", Image.fromarray(PICTURE)


def photo(name):
    shot = SCENES[name].sample(2, SIZE)
    return capture(IMAGES, shot), str(shot.plan), shot.to_dict()


def gradient(name):
    images = IMAGES.clone().requires_grad_()
    with backends.reference():
        taken = capture(images, SCENES[name].sample(2, SIZE))
    return taken, torch.autograd.grad(taken.square().sum(), images)


def replayed():
    shot = Shot.from_dict(CAMERA.sample(2, SIZE).to_dict()).repeat(2)[1:3]
    points = IMAGES[:, 0, :5, :2]
    return shot.numbers(), shot.to_photo(points), shot.to_photo_mask(IMAGES), shot.matrix()


def by_torchvision(scene):
    return list(RandomMoire(scene, p=1.0)(SAMPLE).values()), RandomMoire(scene, p=0.5)(IMAGES)


def by_kornia():
    moire = for_kornia.RandomMoire(SCENE, p=0.5)
    return AugmentationSequential(moire, data_keys=["input", "mask"])(IMAGES, IMAGES[:, :1])


def by_albumentations():
    adversary = for_albumentations.AdversarialMoire(MODEL, SCENE, steps=2, p=1)
    boxes = A.BboxParams("pascal_voc", label_fields=["classes"])
    camera = for_albumentations.RandomMoire(CAMERA, p=1)
    steps = A.Compose([adversary, camera], seed=0, bbox_params=boxes)
    return steps(image=PICTURE, mask=PICTURE[..., 0], bboxes=[(2, 3, 9, 11)], classes=[1], label=1)


def attacked(attack, *targets):
    result = attack(IMAGES, LABELS, *targets)
    return result.images, result.noise, result.success, result.loss, result.eps


def corrupted(corrupt, amount):
    return corrupt(IMAGES, amount, torch.Generator().manual_seed(0))


def evaluated():
    batches = [(PICTURE[None, :16, :16].transpose(0, 3, 1, 2), [1])]
    frame = evaluate(MODEL, batches, "ladder", SCENE, eps=4 / 255, steps=1, progress=False)
    return frame.drop(columns="seconds").to_csv()


def paired():
    pair = make_pair(3, Source(), SCENES["phone_at_monitor"], 32, twin=True, seed=0)
    photos, original = pair.photo[None].float() / 255, pair.original[None].float() / 255
    return pair.pictures(), pair.to_dict(), measure(photos, original)


def through_a_layer():
    camera = ScreenCamera(SCENE, jitter=1.0).eval()
    draw = camera.draw(IMAGES)
    return camera(IMAGES, draw), camera.twin(IMAGES, draw)


def trained():
    model = copy.deepcopy(MODEL)
    images, labels = signs.make("train", 2, 16)
    nn.functional.cross_entropy(model(images.float() / 255), labels % 4).backward()
    return images, labels, [parameter.grad for parameter in model.parameters()]


# modules that keep what they derive from a scene
DERIVED = ("moireaug.scene", "moireaug.camera", "moireaug.engine.lower")
PATHS = {
    "replayed shot": replayed,
    "torchvision": lambda: by_torchvision(SCENE),
    "torchvision in the camera's frame": lambda: by_torchvision(CAMERA),
    "kornia": by_kornia,
    "albumentations": by_albumentations,
    "adversarial": lambda: AdversarialMoire(MODEL, SCENE, steps=2)(IMAGES, LABELS),
    "pgd targeted": lambda: attacked(ATTACKS["pgd"], TARGETS),
    "visibility": lambda: visibility(IMAGES, IMAGES.flip(0)),
    "ladder": evaluated,
    "pairs": paired,
    "room": lambda: tuple(screen_in_room(IMAGES, IMAGES.flip(0), "screen_photo", shrink=(1, 3))),
    "layer": through_a_layer,
    "tiles": lambda: tiled(torch.square, IMAGES, 16, 8),
    "signs": trained,
    "side of a model's images": lambda: models.check_side(MODEL, "small", 16),
    "split": lambda: splits.random_subset(range(20), 5).indices,
    "gains": lambda: results.gains({"clean": "1101"}, {"clean": "0111"}),
}
for name in SCENES:
    PATHS[name] = functools.partial(photo, name)
for name in ("paper", "screen_photo", "box", "flickering", "nlm", "bilateral"):
    PATHS[f"gradient, {name}"] = functools.partial(gradient, name)
for name, attack in ATTACKS.items():
    PATHS[name] = functools.partial(attacked, attack)
for name, defence in DEFENCES.items():
    PATHS[name] = lambda defence=defence: defence()(IMAGES)
for name, (corrupt, (amount, _)) in CORRUPTIONS.items():
    PATHS[name] = functools.partial(corrupted, corrupt, amount)


def result(path):
    torch.manual_seed(0)
    return PATHS[path]()


usual = functools.cache(result)


def assert_same(one, other):
    if isinstance(one, Tensor):
        assert one.dtype == other.dtype and torch.equal(one, other)
    elif isinstance(one, dict):
        assert_same([*one, *one.values()], [*other, *other.values()])
    elif isinstance(one, (tuple, list)):
        for each, its_other in zip(one, other, strict=True):
            assert_same(each, its_other)
    else:
        assert np.array_equal(one, other)


# a narrower default changes numbers and types, a wider one of a photo's must not be taken up either
CASES = [(path, torch.bfloat16) for path in PATHS] + [(name, torch.float64) for name in SCENES]


@pytest.mark.parametrize(("path", "dtype"), CASES, ids=str)
def test_no_result_depends_on_the_defaults(path, dtype):
    expected = usual(path)
    with defaults(dtype):
        assert_same(result(path), expected)


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_no_plan_depends_on_the_defaults(dtype, monkeypatch):
    expected = usual("phone_at_laptop")
    unplanned = dataclasses.replace(SCENES["phone_at_laptop"])
    monkeypatch.setitem(SCENES, "phone_at_laptop", unplanned)
    for name, module in list(sys.modules.items()):  # what has been derived from the scene
        if name.startswith(DERIVED):
            for value in vars(module).values():
                if hasattr(value, "cache_clear"):
                    value.cache_clear()
    with defaults(dtype):
        assert_same(result("phone_at_laptop"), expected)


@pytest.mark.parametrize("precision", ["bf16-true", "16-true"])
def test_attacks_in_a_training_step_of_half_precision(precision):
    plugin = HalfPrecision(precision)
    model = plugin.convert_module(copy.deepcopy(MODEL))
    images = plugin.convert_input(IMAGES)

    def step():
        torch.manual_seed(0)
        photos, _ = AdversarialMoire(model, SCENE, steps=2)(images, LABELS)
        found = MOIRE(model, random_start=1.0)(images, LABELS)
        return photos, found.images, found.noise, found.loss

    with plugin.forward_context():
        shown = step()
    assert_same(shown, step())
    assert [tensor.dtype for tensor in shown] == 2 * [images.dtype] + 2 * [torch.float32]
