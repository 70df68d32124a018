"""APGD and APGD-T: as strong as torchattacks', right about what they return, in hard cases too."""

import copy
import functools

import pytest
import torch

from moireaug import Scene, Sensor, attacks, capture
from moireaug.attacks import LOSSES, PGD, MoireAttack, MultiTargeted, Photographed, SquareMoire
from moireaug.scene.by_name import with_values
from tests.attacks.common import EPS, SCENE, counting, predicted, quietly

N = 48
PLAIN = Scene(sensor=Sensor(cfa="none", exposure="mean", gain=3.0))  # its photo is the image


@pytest.fixture(scope="module")
def learnt(learnt_photos):
    """Three labels are changed after training, so that some images are wrong unattacked."""
    model, images, labels, shot = learnt_photos(N)
    return model, images, torch.cat([(labels[:3] + 1) % 5, labels[3:]]), shot


ROWS = ("ce", "dlr", "targeted dlr")  # of AutoAttack


def beside_torchattacks(row, model, eps, attack_of):
    """(images of torchattacks' attack of that row, ours), as functions of images and labels."""
    library, loss = quietly("torchattacks"), row.removeprefix("targeted ")
    settings = {"eps": eps, "steps": 10, "n_restarts": 1}
    ours = attack_of(eps=eps, steps=10, rule="apgd", loss=loss)
    if row == loss:
        return library.APGD(model, loss=loss, **settings), ours
    return library.APGDT(model, n_classes=5, **settings), MultiTargeted(ours)


@pytest.mark.parametrize("row", ROWS)
@pytest.mark.parametrize("saturated", [False, True])
def test_no_more_readings_stay_right_than_under_torchattacks(row, saturated, learnt):
    """Of 48 readings at most one more; also with logits times 1e4, where softmax is 0 and 1."""
    model, images, labels, shot = learnt
    if saturated:
        model = copy.deepcopy(model)
        for parameter in model.net[-1].parameters():
            parameter.data *= 1e4
    camera = Photographed(model, images, shot)
    attack_of = functools.partial(MoireAttack, model, scene=SCENE)
    theirs, ours = beside_torchattacks(row, camera, EPS, attack_of)
    result = ours(images, labels, shot=shot)
    found = [theirs(camera.clean, labels), camera.clean + result.noise, camera.clean]
    left_by_them, left_by_us, left = ((predicted(camera, x) == labels).sum() for x in found)
    assert left_by_us == (~result.success).sum()
    assert 5 < left_by_us <= left_by_them + 1
    assert left_by_us + 10 < left


@pytest.mark.parametrize("row", ROWS)
def test_no_more_images_stay_right_than_under_torchattacks(row, learnt):
    """Of PGD on pixels, some of which are black or white."""
    model, images, _, shot = learnt
    photos = capture(images, shot).mul(2).sub(0.5).clamp(0, 1)
    labels = predicted(model, photos)
    assert ((photos == 0) | (photos == 1)).float().mean() > 0.05
    theirs, ours = beside_torchattacks(row, model, EPS, functools.partial(PGD, model))
    left_by_them = (predicted(model, theirs(photos, labels)) == labels).sum()
    generator = torch.Generator().manual_seed(0)
    left_by_us = (~ours(photos, labels, generator=generator).success).sum()
    assert 2 < left_by_us <= left_by_them + 1 < 40


def test_noise_stays_where_pixels_can_go():
    """Inside [0, 1]: a white pixel pushed outward comes back when the gradient turns."""

    def model(x):
        far = (x.mean((1, 2, 3)) - 0.99).abs()
        return torch.stack([-far, far - 0.015, far * 0 - 9], 1)

    images = torch.full((1, 3, 4, 4), 0.999)
    for attack in (
        PGD(model, eps=EPS, steps=20, step_size=0.5),
        PGD(model, eps=EPS, steps=20, rule="apgd"),
    ):
        start = torch.Generator().manual_seed(1)
        result = attack(images, torch.tensor([1]), generator=start)
        shown = images + result.noise
        assert shown.max() <= 1 and shown.min() > 0.9
        assert (result.images.mean() - 0.99).abs() < 0.005


DECOY = torch.tensor([[0.0, 0.03, -1.0, 0.0, 0.0], [0.0, -0.1, -2.0, -9.0, -9.0]])


def misled(x):
    """Logits in one number s: the second class is near, never reached; the third is the way out."""
    s = (x.mean((1, 2, 3)) - 0.5)[:, None] * 100
    return 20 * (s * DECOY[0] + DECOY[1])


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("kind", ["ma", "pgd"])
def test_several_targets_find_what_one_direction_misses(loss, kind):
    images, labels = torch.full((2, 3, 8, 8), 0.5), torch.zeros(2, dtype=torch.long)
    settings = {"eps": 0.03, "steps": 10, "rule": "apgd", "loss": loss}
    attack = MoireAttack(misled, scene=PLAIN, **settings)
    if kind == "pgd":
        attack = PGD(misled, random_start=0.0, **settings)
    assert not attack(images, labels).success.any()
    assert not MultiTargeted(attack, targets=1)(images, labels).success.any()
    found = MultiTargeted(attack, targets=2)(images, labels)
    assert found.success.all() and predicted(misled, found.images).tolist() == [2, 2]


SETTINGS = {
    "ma": {},
    "photo": {"noise_at": "photo"},
    "turned": {"optimise": ("noise", "view")},
    "eot": {"eot": 2},
    "restarts": {"restarts": 2},
    "signs": {"rule": "sign"},
}


@pytest.mark.parametrize("name", SETTINGS)
def test_a_result_is_what_it_says(name, learnt):
    model, images, labels, shot = learnt
    settings = {"rule": "apgd", "loss": "dlr"} | SETTINGS[name]
    attack = MultiTargeted(MoireAttack(model, scene=SCENE, eps=EPS, steps=3, **settings), targets=2)
    result = attack(images, labels, shot=shot, generator=torch.Generator().manual_seed(0))
    assert torch.equal(result.success, predicted(model, result.images) != labels)
    assert 0.2 < result.success.float().mean() < 1
    assert result.noise.abs().max() <= EPS * (1 + 1e-5)
    assert result.loss.shape == (3,) and result.eps == EPS
    if name == "photo":
        shown = (capture(images, result.shot) + result.noise).clamp(0, 1)
    else:
        shown = capture(images, result.shot, result.noise)
    assert torch.allclose(shown, result.images, atol=1e-5)
    turned = (result.shot.view.roll != shot.view.roll).any()
    assert turned == (name == "turned")
    photos = (capture(images, shot), result.images)
    before, after = (attacks.margin(model(x), labels) for x in photos)
    assert (after >= before - 1e-5)[~result.success].all() and after.mean() > before.mean() + 0.1
    wrong = before > 0
    # was wrong unattacked, and is given back as it was
    assert wrong.any() and (result.noise[wrong] == 0).all()


def test_more_targets_never_leave_more_right(learnt):
    model, images, labels, shot = learnt
    attack = MoireAttack(model, scene=SCENE, eps=EPS, steps=4, rule="apgd", loss="dlr")
    found = [MultiTargeted(attack, targets=k)(images, labels, shot=shot).success for k in (1, 2, 9)]
    assert (found[1] | ~found[0]).all() and (found[2] | ~found[1]).all()


def test_what_is_done_is_not_asked_again(learnt):
    """Four targets of five classes, and in each only the images that are still right: two
    queries for the photos without noise, the second to see whether answers repeat; for each
    target three of steps and one of the last point; and one that judges the result."""
    model, images, labels, shot = learnt
    counted, asked = counting(model)
    attack = MoireAttack(counted, scene=SCENE, eps=EPS, steps=3, rule="apgd", loss="dlr")
    result = MultiTargeted(attack)(images, labels, shot=shot)
    assert asked[0] == asked[-1] == N and len(asked) == 2 + 4 * 4 + 1
    rounds = asked[2:-1:4]
    assert rounds == sorted(rounds, reverse=True)
    assert N > rounds[0] > rounds[-1] >= (~result.success).sum()


def test_other_attacks_steer_toward_a_class_too(learnt):
    model, images, labels, shot = learnt
    attack = SquareMoire(model, scene=SCENE, eps=3 * EPS, steps=20)
    result = MultiTargeted(attack, targets=2)(images, labels, shot=shot)
    assert result.success.sum() > (predicted(model, capture(images, shot)) != labels).sum() + 5


def constant(x):
    """All logits tie, and no gradient says more."""
    return 0 * x.mean((2, 3)).repeat(1, 2)


def deaf(x):
    """Sure of the first class, whatever is shown; its gradients are 0."""
    return torch.tensor([3.0, 2.0, 1.0, 0.0, -1.0, -2.0]) + constant(x)


@pytest.mark.parametrize("model", [constant, deaf])
@pytest.mark.parametrize("loss", LOSSES)
def test_a_model_without_a_slope_is_left_alone(model, loss):
    images, labels = torch.rand(3, 3, 8, 8), torch.tensor([0, 0, 1])
    attack = MoireAttack(model, scene=PLAIN, eps=EPS, steps=10, rule="apgd", loss=loss)
    for either in (attack, MultiTargeted(attack)):
        result = either(images, labels)
        assert result.success.tolist() == [False, False, True]
        assert not result.noise.any() and torch.equal(result.images, PLAIN.capture(images))


def test_classes_that_are_ruled_out_are_no_targets():
    """Where minus infinity leaves one class beside the label."""
    ruled_out = torch.tensor([0.0, 0.0] + [-torch.inf] * 4)
    attack = PGD(lambda x: deaf(x) + ruled_out, steps=1)
    result = MultiTargeted(attack)(torch.rand(2, 3, 8, 8), torch.tensor([0, 1]))
    assert result.success.tolist() == [False, True]


def test_images_that_are_all_wrong_have_no_losses_as_no_step_was_taken(learnt):
    model, images, _, shot = learnt
    wrong = (predicted(model, capture(images, shot)) + 1) % 5
    result = MultiTargeted(MoireAttack(model, scene=SCENE, eps=EPS, steps=2))(
        images[:8], wrong[:8], shot=shot[:8]
    )
    assert len(result.loss) == 0 and "step" not in repr(result)
    assert torch.equal(result.images, capture(images[:8], shot[:8]))


def test_an_expectation_goes_on_though_the_shot_is_nearer_than_other_draws():
    """The shot is brighter than any other draw, and so its margin without noise is out of their
    reach: noise that fools the shot must not be given up for none."""
    scene = Scene(sensor=Sensor(cfa="none", exposure="mean", gain=(0.9, 0.901)))
    images, labels = torch.full((2, 3, 8, 8), 0.8), torch.zeros(2, dtype=torch.int64)
    shot = with_values(scene.sample(2, (8, 8)), {"sensor.gain": torch.ones(2, dtype=torch.float64)})
    limit = capture(images, shot).mean() + EPS / 2

    def model(photos):
        brightness = photos.mean((1, 2, 3))
        return torch.stack([limit - brightness, brightness - limit], 1)

    attack = MoireAttack(model, scene=scene, eps=EPS, steps=3, eot=2)
    assert attack(images, labels, shot=shot).success.all()
    assert MultiTargeted(attack)(images, labels, shot=shot).success.all()
