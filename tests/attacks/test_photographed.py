"""Attacks of other libraries through the camera: whatever they do, a row meets its own shot."""

import copy

import pytest
import torch
from torch import nn

from moireaug import Scene, Sensor, capture, develop, expose
from moireaug.attacks import MoireAttack, Photographed
from moireaug.attacks.bounds import BOUNDS
from moireaug.attacks.photographed import CAMERAS
from tests.attacks.common import EPS, SCENE, predicted, quietly, refusal

N = 16


@pytest.fixture(scope="module")
def learnt(learnt_photos):
    """A model that is right about these photos, their images, labels and shot."""
    model, images, labels, shot = learnt_photos(N)
    assert torch.equal(predicted(model, capture(images, shot)), labels)
    return model, images, labels, shot


class Naive(nn.Module):
    """A camera that takes rows as they come: the mistake that Photographed is there to avoid."""

    def __init__(self, camera, noise_at="raw"):
        super().__init__()
        self.model, self.shot, self.clean = camera.model, camera.shot, camera.clean
        self.camera = CAMERAS[noise_at]

    def forward(self, x):
        return self.model(self.camera(x, self.shot[: len(x)]))


ROWS = {
    "in order": list(range(N)),
    "permuted": torch.randperm(N, generator=torch.Generator().manual_seed(3)).tolist(),
    "dropped": [1, 2, 5, 11],
    "one": [7],
    "repeated": [3, 3, 0, 9, 3],
    "more than there are": [*range(N), *range(N)],
    "none": [],
}


@pytest.mark.parametrize("noise_at", CAMERAS)
def test_rows_meet_their_own_shots(learnt, noise_at):
    model, images, _, shot = learnt
    camera = Photographed(model, images, shot, noise_at=noise_at)
    noise = torch.empty_like(camera.clean).uniform_(-8 / 255, 8 / 255)
    x = (camera.clean + noise).clamp(0, 1)
    logits = model(CAMERAS[noise_at](x, shot))  # all rows in order: nothing to mix up
    naive = Naive(camera, noise_at)
    for name, rows in ROWS.items():
        assert camera.rows(x[rows]).tolist() == rows, name
        assert torch.allclose(camera(x[rows]), logits[rows], atol=1e-4), name
        if name in ("permuted", "dropped", "one", "repeated"):
            assert not torch.allclose(naive(x[rows]), logits[rows], atol=1e-2), name


@pytest.mark.parametrize("noise_at", CAMERAS)
def test_gradients_are_those_of_the_camera(learnt, noise_at):
    model, images, labels, shot = learnt
    camera, rows = Photographed(model, images, shot, noise_at=noise_at), [9, 4, 4]
    x = camera.clean[rows].requires_grad_(True)
    logits = (camera(x), model(CAMERAS[noise_at](x, shot[rows])))
    losses = (nn.functional.cross_entropy(z, labels[rows]) for z in logits)
    ours, expected = (torch.autograd.grad(loss, x)[0] for loss in losses)
    assert torch.equal(ours, expected) and (ours != 0).any((1, 2, 3)).all()


@pytest.fixture(scope="module")
def ours(learnt):
    """Whether our attack fools each image."""
    model, images, labels, shot = learnt
    settings = {"rule": "apgd", "loss": "margin", "restarts": 2}
    attack = MoireAttack(model, scene=SCENE, eps=EPS, steps=40, **settings)
    return attack(images, labels, shot=shot).success


def of_torchattacks(name, **settings):
    def attack(camera, labels):
        made = getattr(quietly("torchattacks"), name)(camera, **settings)
        if name == "AutoAttack":
            made._autoattack.attacks[-1].n_queries = 20  # of the Square Attack, which takes 5000
        with torch.enable_grad():
            return made(camera.clean, labels)

    return attack


def of_foolbox(name, eps=EPS, **settings):
    def attack(camera, labels):
        foolbox = quietly("foolbox")
        model = foolbox.PyTorchModel(camera, bounds=(0, 1))
        made = getattr(foolbox.attacks, name)(**settings)
        return made(model, camera.clean, labels, epsilons=eps)[1]

    return attack


def of_art(name, **settings):
    def attack(camera, labels):
        quietly("art.estimators.classification")
        art = quietly("art")
        bounds = {"clip_values": (0, 1), "device_type": "cpu"}
        classifier = art.estimators.classification.PyTorchClassifier(
            camera, nn.CrossEntropyLoss(), tuple(camera.clean.shape[1:]), 5, **bounds
        )
        made = getattr(quietly("art.attacks.evasion"), name)(classifier, verbose=False, **settings)
        return torch.from_numpy(made.generate(camera.clean.numpy(), labels.numpy()))

    return attack


BOUNDED = {
    "torchattacks AutoAttack": of_torchattacks("AutoAttack", eps=EPS, n_classes=5, seed=0),
    "torchattacks PGD": of_torchattacks("PGD", eps=EPS, alpha=EPS / 4, steps=20),
    "foolbox PGD": of_foolbox("LinfPGD", rel_stepsize=0.25, steps=20),
    "ART PGD": of_art(
        "ProjectedGradientDescent", eps=EPS, eps_step=EPS / 4, max_iter=15, batch_size=5
    ),
}


@pytest.fixture(autouse=True)
def _no_files_at_home(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))  # where ART writes when it is imported


@pytest.mark.parametrize("attack", BOUNDED.values(), ids=BOUNDED)
def test_what_others_find_in_the_ball_is_what_we_find(learnt, ours, attack):
    model, images, labels, shot = learnt
    camera, asked = Photographed(model, images, shot), []
    camera.register_forward_pre_hook(lambda module, args: asked.append(args[0].detach()))
    x = attack(camera, labels)
    moved = False
    for query in asked[::10]:
        rows = camera.rows(query)
        far = torch.cdist(query.flatten(1), camera.clean.flatten(1), p=torch.inf)
        near = far.amin(1) < 4 * EPS  # another measure of what is near, and as clear
        assert torch.equal(rows[near], far.argmin(1)[near])
        moved = moved or rows.tolist() != list(range(len(rows)))
    assert moved or attack is not BOUNDED["torchattacks AutoAttack"]  # which drops rows
    assert x.min() >= 0 and x.max() <= 1 and (x - expose(images, shot)).abs().max() <= EPS * 1.001
    theirs = predicted(model, develop(x, shot)) != labels  # judged with all rows in order
    assert torch.equal(theirs, predicted(camera, x) != labels)
    assert 0.1 < ours.float().mean() < 1
    assert (ours.sum() - theirs.sum()).abs() <= 2


UNBOUNDED = {
    "torchattacks DeepFool": of_torchattacks("DeepFool", steps=20),
    "ART DeepFool": of_art("DeepFool", max_iter=20, batch_size=5),
}


@pytest.mark.parametrize("attack", UNBOUNDED.values(), ids=UNBOUNDED)
def test_attacks_may_take_rows_few_at_a_time(learnt, attack):
    """Where rows meet their own shots, nearly all are fooled; else less than half as many."""
    model, images, labels, shot = learnt
    camera, rates = Photographed(model, images, shot), []
    for which in (camera, Naive(camera).eval()):
        x = attack(which, labels)
        assert (x - camera.clean).abs().max() < 0.5
        rates.append((predicted(model, develop(x, shot)) != labels).float().mean())
    assert rates[0] > max(0.8, 2 * rates[1])


@pytest.mark.parametrize("noise_at", CAMERAS)
def test_what_cannot_be_told_apart_is_refused(learnt, noise_at):
    model, images, _, shot = learnt
    camera = Photographed(model, images, shot, noise_at=noise_at)
    clean = camera.clean
    between = torch.stack([clean[0], (clean[1] + clean[2]) / 2])
    for x, message in (
        (between, r"row 1 is too far .* row (1|2) is the nearest .*one image at a time"),
        (1 - clean[:3], "one image at a time"),
        (torch.full_like(clean[:1], torch.nan), "not finite"),
        *((wrong, r"shape \(b, .* got") for wrong in (clean[0], clean[..., 1:], clean[:, :2])),
    ):
        with pytest.raises(ValueError, match=message):
            camera(x)
    # a quarter of the way is the limit
    assert camera.rows(torch.lerp(clean[1:2], clean[2:3], 0.2)).tolist() == [1]
    with pytest.raises(ValueError, match="row 0"):
        camera.rows(torch.lerp(clean[1:2], clean[2:3], 0.3))


def test_one_image_at_a_time_takes_any_attack(learnt):
    model, images, labels, shot = learnt
    attack = of_foolbox("BoundaryAttack", eps=None, steps=30)
    x = attack(Photographed(model, images[3:4], shot[3:4]), labels[3:4])
    assert predicted(model, develop(x, shot[3:4])) != labels[3]
    with pytest.raises(ValueError, match="one image at a time"):
        attack(Photographed(model, images, shot), labels)


STILL = Scene(sensor=Sensor(scale=2.0, gain=2.0))  # nothing is drawn


NOISY = Scene(sensor=Sensor(read_noise=0.01))


@pytest.mark.parametrize(
    ("scene", "noise_at"),
    [(STILL, "raw"), (STILL, "image"), (SCENE, "raw"), (NOISY, "raw")],
)
def test_the_same_image_twice_where_its_shots_tell_it_apart(learnt, scene, noise_at):
    """A turned camera or the sensor's noise makes two readings of it, or either shot will do."""
    model, images, _, _ = learnt
    images, shot = images[[0, 1, 0]], scene.sample(3, (16, 16))
    camera = Photographed(model, images, shot, noise_at=noise_at)
    expected = model(capture(images, shot))[[2, 1]]
    assert torch.allclose(camera(camera.clean[[2, 1]]), expected, atol=1e-5)


def test_rows_alike_with_different_shots_are_refused(learnt):
    model, images, _, _ = learnt
    for scene in (SCENE, NOISY):
        with pytest.raises(ValueError, match="rows 0 and 2 have the same image but different"):
            Photographed(model, images[[0, 1, 0]], scene.sample(3, (16, 16)), noise_at="image")
    with pytest.raises(ValueError, match="rows 0 and 1 have the same raw but different shots"):
        Photographed(model, torch.zeros(2, 3, 16, 16), SCENE.sample(2, (16, 16)))


def test_an_attack_leaves_the_model_as_it_found_it(learnt, trained):
    """torchattacks puts back the mode of what it was given, into every part of it."""
    model, images, labels, shot = learnt
    of_torchattacks("PGD", steps=1)(Photographed(model, images, shot), labels)
    assert not any(part.training for part in model.modules())
    assert Photographed(copy.deepcopy(model).train(), images, shot).training


def test_photos_are_of_the_images_dtype(learnt):
    _, images, _, shot = learnt
    for dtype in (torch.float64, torch.float16):
        camera = Photographed(lambda x: x.mean((2, 3)), images.to(dtype), shot)
        logits = camera(camera.clean.double()[[3, 1]])
        assert logits.dtype == dtype == camera.photos(camera.clean).dtype


def test_arguments_that_do_not_go_together(learnt):
    model, images, _, shot = learnt
    for change, sentence in (
        ({"model": 3}, "Photographed's model must be a function"),
        ({"noise_at": "photo"}, "noise_at must be one of 'raw', 'image'"),
        ({"bound": "raw"}, "bound must be one of 'codes', 'light'"),
        ({"images": images[:2]}, "drawn for 16 images"),
        ({"images": images * 255}, "lie in [0, 1]"),
    ):
        given = {"model": model, "images": images, "shot": shot} | change
        assert sentence in refusal(lambda given=given: Photographed(**given))


def test_inputs_are_codes_where_readings_are_light(learnt):
    """The box of our attack is the outside attacker's own ball; "light" takes readings."""
    model, images, labels, _ = learnt
    shot = Scene.preset("screen_photo").sample(N, (16, 16), torch.Generator().manual_seed(0))
    reading = expose(images, shot)
    in_codes, in_light = (
        Photographed(model, images, shot, bound=bound) for bound in ("codes", "light")
    )
    assert torch.equal(in_light.clean, reading)
    assert torch.allclose(in_codes.clean[reading < 0.003], 12.92 * reading[reading < 0.003])
    result = MoireAttack(model, eps=EPS, steps=2)(images, labels, shot=shot)
    attacked = reading + result.noise
    inside = attacked.clamp(0, 1) == attacked
    x = torch.where(attacked > 0.0031308, 1.055 * attacked.clamp(min=0) ** (1 / 2.4) - 0.055, 0)
    x = torch.where(attacked > 0.0031308, x, 12.92 * attacked)
    moved = (x - in_codes.clean)[inside].abs().max()
    assert 0.999 * EPS < moved < 1.001 * EPS
    assert torch.allclose(in_codes.photos(x), result.images, atol=1e-4)
    theirs = of_torchattacks("PGD", eps=EPS, alpha=EPS / 4, steps=10)(in_codes, labels)
    assert (theirs - in_codes.clean).abs().max() <= EPS * 1.001
    fooled = predicted(in_codes, theirs) != labels
    ours = MoireAttack(model, eps=EPS, steps=10, step_size=0.25)(images, labels, shot=shot).success
    assert (fooled.sum() - ours.sum()).abs() <= 2
    plain = [Photographed(model, images, learnt[3], bound=bound).clean for bound in BOUNDS]
    assert torch.equal(*plain)
