"""Attacks on a list of scenes: each scene's images are attacked as a batch of their own."""

import dataclasses

import pytest
import torch

from moireaug import Lens, Scene, Sensor, View, attacks, capture
from moireaug.attacks import MoireAttack, MultiTargeted, SquareMoire
from moireaug.mixtures import as_scenes
from tests.attacks.common import EPS, SCENE, predicted, refusal

OTHER = dataclasses.replace(SCENE, lens=Lens(blur=0.3), sensor=Sensor(scale=2.0, gain=1.4))
COLOURS = dataclasses.replace(SCENE, sensor=Sensor(scale=2.0, gain=2.0, cfa="none"))
ALIKE, UNLIKE = [SCENE, OTHER], [SCENE, COLOURS]  # in the shape of their readings
STEPS = {"eps": EPS, "steps": 2}


def drawn(scenes, batch):
    shot = as_scenes(scenes).sample(6, batch[0].shape[-2:], torch.Generator().manual_seed(1))
    assert len(shot.by_scene()) == 2
    return shot


ATTACKS = {
    "plain": lambda m, scene: MoireAttack(m, scene=scene, **STEPS),
    "targeted": lambda m, scene: MoireAttack(m, scene=scene, **STEPS),
    "apgd": lambda m, scene: MoireAttack(m, scene=scene, rule="apgd", loss="margin", **STEPS),
    "photo": lambda m, scene: MoireAttack(m, scene=scene, noise_at="photo", **STEPS),
    "pose": lambda m, scene: MoireAttack(m, scene=scene, optimise=("view",), **STEPS),
    "both": lambda m, scene: MoireAttack(m, scene=scene, optimise=("noise", "view"), **STEPS),
    "fooled": lambda m, scene: MoireAttack(m, scene=scene, until_fooled=True, **STEPS),
    "toward": lambda m, scene: MultiTargeted(MoireAttack(m, scene=scene, **STEPS), targets=2),
}


# a pose takes seconds to search
CASES = {f"{name} alike": (name, ALIKE) for name in ATTACKS if name != "both"}
CASES |= {f"{name} unlike": (name, UNLIKE) for name in ATTACKS if name != "pose"}


@pytest.mark.parametrize(("name", "scenes"), CASES.values(), ids=CASES)
def test_every_scenes_images_are_attacked_as_if_alone(name, scenes, model, batch):
    images, labels = batch = batch[0][:, :, :8, :8], batch[1]
    shot, given = drawn(scenes, batch), (images, labels)
    if name == "targeted":
        given += ((labels + 1 + torch.arange(6) % 3) % 5,)
    result = ATTACKS[name](model, scenes)(*given, shot=shot)
    for rows, part in shot.by_scene():
        alone = ATTACKS[name](model, part.scene)(*(x[rows] for x in given), shot=part)
        assert torch.equal(result.images[rows], alone.images)
        assert torch.equal(result.success[rows], alone.success)
        for place, row in enumerate(rows.tolist()):
            assert torch.equal(result.noise[row], alone.noise[place])
        for key, values in alone.shot.numbers().items():
            assert torch.equal(result.shot.numbers()[key][rows], values)
    assert isinstance(result.noise, list) == (scenes is UNLIKE and name != "photo")
    if name != "photo":
        photos = capture(images, result.shot, result.noise)
        assert torch.allclose(photos, result.images, atol=1e-6)
    hit = predicted(model, result.images)
    assert torch.equal(result.success, hit == given[2] if name == "targeted" else hit != labels)
    assert torch.equal(result.correct, hit == labels)
    before = predicted(model, capture(images, shot)) == labels
    assert torch.equal(result.clean_correct, before)


def test_the_loss_is_the_mean_over_the_batch(model, batch):
    images, labels = batch
    shot = drawn(ALIKE, batch)
    result = MoireAttack(model, scene=ALIKE, **STEPS)(images, labels, shot=shot)
    with attacks.evaluating(model), torch.no_grad():
        first = torch.nn.functional.cross_entropy(model(capture(images, shot)), labels)
    assert result.loss.shape == (2,) and result.loss[0] == pytest.approx(first.item(), rel=1e-5)


def test_an_expectation_is_over_draws_of_the_images_own_scene(model, batch):
    images, labels = batch
    fixed = [dataclasses.replace(scene, view=View(roll=3.0)) for scene in ALIKE]
    shot = drawn(fixed, batch)
    result = MoireAttack(model, scene=fixed, eot=2, **STEPS)(images, labels, shot=shot)
    for rows, part in shot.by_scene():
        # without a range or noise, every draw of a scene is the same
        attack = MoireAttack(model, scene=part.scene, eot=2, **STEPS)
        alone = attack(images[rows], labels[rows], shot=part)
        assert torch.equal(result.images[rows], alone.images)


def test_draws_follow_the_generator_in_lists_of_any_length(model, batch):
    def attacked(scene, seed):
        attack = MoireAttack(model, scene=scene, random_start=1.0, **STEPS)
        return attack(*batch, generator=torch.Generator().manual_seed(seed))

    first, again = attacked(ALIKE, 1), attacked(ALIKE, 1)
    assert torch.equal(first.images, again.images)
    assert torch.equal(first.shot.scene_index, drawn(ALIKE, batch).scene_index)
    assert not torch.equal(first.images, attacked(ALIKE, 2).images)
    assert torch.equal(attacked([SCENE], 1).images, attacked(SCENE, 1).images)
    assert isinstance(attacked([SCENE], 1).shot, type(SCENE.sample(1, (4, 4))))


def test_a_shot_of_one_scene_is_attacked_in_that_scene(model, batch):
    shot = OTHER.sample(6, (16, 16), torch.Generator().manual_seed(0))
    found = []
    for scene in (ALIKE, SCENE, OTHER):
        attack = MoireAttack(model, scene=scene, eot=2, **STEPS)
        generator = torch.Generator().manual_seed(0)
        found.append(attack(*batch, shot=shot, generator=generator))
    assert torch.equal(found[0].images, found[2].images)
    assert torch.equal(found[1].images, found[2].images)


def test_training_takes_the_last_step_of_every_scene(model, batch):
    images, labels = batch
    shot = drawn(UNLIKE, batch)
    photos = MoireAttack(model, scene=UNLIKE, **STEPS).last(images, labels, shot=shot)
    for rows, part in shot.by_scene():
        alone = MoireAttack(model, scene=part.scene, **STEPS)
        assert torch.equal(photos[rows], alone.last(images[rows], labels[rows], shot=part))


def test_a_search_without_gradients_takes_a_list_and_no_images(model, batch):
    attack = SquareMoire(model, scene=ALIKE, eps=8 / 255, steps=4)
    for n in (0, 6):
        images, labels = batch[0][:n], batch[1][:n]
        result = attack(images, labels)
        photos = capture(images, result.shot, result.noise)
        assert photos.shape == images.shape and torch.allclose(photos, result.images, atol=1e-6)
        assert len(result.shot) == len(result.success) == len(result.noise) == n


STILL = Scene(panel=SCENE.panel)  # nothing in it varies but the phase of its light
REFUSED = [
    (lambda m, x, y: MoireAttack(m, scene=ALIKE)(x, y[:3]), "must have the shape (6,)"),
    (lambda m, x, y: MoireAttack(m, scene=ALIKE)(x, y, y), "other classes than the labels"),
    (lambda m, x, y: MoireAttack(m, scene=ALIKE)(255 * x, y), "look like 0 to 255"),
    (lambda m, x, y: MoireAttack(m)(x, y, shot=drawn(ALIKE, (x, y))[:4]), "drawn for 4 images"),
    (lambda m, x, y: MoireAttack(m, scene=[SCENE, STILL], optimise=("view",)), "has no range in"),
    (lambda m, x, y: attacks.PGD(m)(x, y, shot=drawn(ALIKE, (x, y))), "shot"),
    (lambda m, x, y: MultiTargeted(attacks.PGD(m))(x, y, shot=drawn(ALIKE, (x, y))), "shot"),
]


def test_what_does_not_fit_is_refused(model, batch):
    for call, sentence in REFUSED:
        assert sentence in refusal(call, model, *batch)
