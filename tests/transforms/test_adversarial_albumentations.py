"""AdversarialMoire in albumentations: one image at a time, its class passed as a target."""

import json

# isort: skip  # after moireaug, which keeps it from asking for its newest version
import albumentations as A
import numpy as np
import pytest
import torch
from torch import nn

from moireaug import Shot
from moireaug.attacks import MoireAttack
from moireaug.scene.track import DEFAULT_HAND, track_of
from moireaug.transforms import albumentations as moire
from tests.attacks.common import counting
from tests.transforms.common import REGISTERED


@pytest.fixture
def model():
    torch.manual_seed(0)
    features = nn.Sequential(nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4), nn.ReLU())
    return nn.Sequential(features, nn.AdaptiveAvgPool2d(2), nn.Flatten(), nn.Linear(16, 3))


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
@pytest.mark.parametrize("shape", [(12, 14, 3), (12, 14)], ids=str)
def test_it_raises_the_loss(dtype, shape, model):
    white = 255 if dtype == np.uint8 else 1
    image = (np.random.default_rng(0).random(shape) * white).astype(dtype)
    attacked = moire.AdversarialMoire(model, REGISTERED, eps=16 / 255, steps=5, p=1)
    steps = A.ReplayCompose([attacked])
    steps.set_random_seed(0)
    out = steps(image=image, label=1)
    assert out["image"].dtype == dtype and out["image"].shape == shape and out["label"] == 1
    params = out["replay"]["transforms"][0]["params"]
    plain = moire.apply_to_one(image, Shot.from_dict(params["shot"]))

    def loss(shown):
        x = torch.from_numpy(np.ascontiguousarray(shown)).float() / white
        x = x.reshape(1, *shape[:2], -1).permute(0, 3, 1, 2).expand(-1, 3, -1, -1)
        return nn.functional.cross_entropy(model.eval()(x), torch.tensor([1])).item()

    assert loss(out["image"]) > loss(plain)
    assert np.abs(np.array(params["noise"]["image"])).max() <= 16 / 255 + 1e-6


def test_the_noise_is_that_after_the_last_step_as_in_torchvisions(model):
    """One forward pass a step, and none to find the best of them."""
    (image,), settings = frames(1), {"eps": 16 / 255, "steps": 3, "step_size": 1.9}
    counted, asked = counting(model.eval())
    adversarial = moire.AdversarialMoire(counted, REGISTERED, random_start=0.0, **settings, p=1)
    steps = A.ReplayCompose([adversarial])
    steps.set_random_seed(0)
    out = steps(image=image, label=1)
    assert asked == [1] * 3
    shot = Shot.from_dict(out["replay"]["transforms"][0]["params"]["shot"])
    images, labels = torch.from_numpy(image).permute(2, 0, 1)[None], torch.tensor([1])
    attack = MoireAttack(model, scene=REGISTERED, **settings)
    photo = attack.last(images, labels, shot=shot)[0].permute(1, 2, 0).numpy()
    assert np.allclose(out["image"], photo, atol=1e-5)


def test_mode_is_kept_and_draws_follow_the_seed(model):
    (image,), model = frames(1), model.train()
    adversarial = moire.AdversarialMoire(model, REGISTERED, steps=2, p=1)
    pipeline = A.Compose([adversarial], seed=3)
    first = pipeline(image=image, label=0)["image"]
    assert np.array_equal(first, A.Compose([adversarial], seed=3)(image=image, label=0)["image"])
    pipeline = A.Compose([adversarial], seed=3)
    pipeline(image=image, label=0)
    assert not np.array_equal(first, pipeline(image=image, label=0)["image"])
    assert model.training


def test_a_call_without_a_label_of_the_model_is_refused(model):
    steps = A.Compose([moire.AdversarialMoire(model, REGISTERED, p=1)])
    image = np.zeros((8, 8, 3), np.uint8)
    with pytest.raises(ValueError, match="call the Compose with label=<int>"):
        steps(image=image)
    with pytest.raises(ValueError, match=r"\[0, 2\], the model's classes"):
        steps(image=image, label=7)
    with pytest.raises(TypeError, match=r"label must be .* an integer; got 'cat'"):
        steps(image=image, label="cat")


def frames(n=3, shape=(12, 14, 3)):
    return np.random.default_rng(1).random((n, *shape)).astype(np.float32)


def test_strict_and_with_images_alone(model):
    images = frames()
    for transform, labels in (
        (moire.AdversarialMoire(model, REGISTERED, steps=2, p=1), {"label": 1}),
        (moire.RandomMoire(REGISTERED, p=1), {}),
    ):
        out = A.Compose([transform], strict=True, seed=0)(images=images, **labels)["images"]
        assert out.shape == images.shape and not np.array_equal(out, images)


def test_each_picture_has_noise_of_its_own_whatever_its_target(model):
    images = frames(4)
    adversarial = moire.AdversarialMoire(model, REGISTERED, eps=0.1, steps=2, p=1)
    steps = A.ReplayCompose([adversarial], is_check_shapes=False)
    given = {"image": images[0], "images": images[1:3], "volume": images[1:]}
    out = steps(**given, label=1)
    params = out["replay"]["transforms"][0]["params"]
    noise = {target: torch.tensor(rows) for target, rows in params["noise"].items()}
    assert list(map(len, noise.values())) == [1, 2, 3]
    assert len(torch.cat([*noise.values()]).unique(dim=0)) == 6
    for target, i in (("images", 1), ("volume", 2)):
        shot = track_of(Shot.from_dict(params["shot"]), [i + 1], DEFAULT_HAND)[i]
        expected = moire.apply_to_one(given[target][i], shot, noise[target][i : i + 1])
        assert np.array_equal(out[target][i], expected)


def test_a_replay_needs_no_model(model):
    image = frames(1)[0]
    steps = A.ReplayCompose([moire.AdversarialMoire(model, REGISTERED, steps=2, p=1)])
    out = steps(image=image, label=1)
    again = A.ReplayCompose.replay(json.loads(json.dumps(out["replay"])), image=image)
    assert np.array_equal(again["image"], out["image"])
    with pytest.raises(ValueError, match=r"recorded at, \(12, 14\); got \(24, 28\)"):
        A.ReplayCompose.replay(out["replay"], image=frames(1, (24, 28, 3))[0])


def test_a_replay_on_pictures_without_noise_is_refused(model):
    steps = A.ReplayCompose([moire.AdversarialMoire(model, REGISTERED, steps=1, p=1)])
    replay = steps(images=frames(2), volume=frames(2), label=1)["replay"]
    for other in ({"images": frames(3)}, {"image": frames(1)[0]}):
        with pytest.raises(ValueError, match="attacked: 2 as images, 2 as volume; got"):
            A.ReplayCompose.replay(replay, **other)


def test_it_is_written_as_lambda_is(model):
    nameless = A.Compose([moire.AdversarialMoire(model, REGISTERED)])
    with pytest.raises(ValueError, match="give it a name"):
        A.to_dict(nameless)
    named = moire.AdversarialMoire(model, REGISTERED, name="mine")
    written = json.loads(json.dumps(A.to_dict(A.Compose([named]))))
    assert A.from_dict(written, nonserializable={"mine": named})[0] is named
    with pytest.raises(ValueError, match="mine"):
        A.from_dict(written)


def test_no_model_and_several_bounds_are_refused(model):
    with pytest.raises(TypeError, match="model must be a function or a torch module"):
        moire.AdversarialMoire("resnet18", REGISTERED)
    with pytest.raises(ValueError, match="Make one attack per value"):
        moire.AdversarialMoire(model, REGISTERED, eps=[0.1, 0.2])


def test_a_picture_in_an_additional_target_is_refused(model):
    """It would get the noise of another one."""
    image, *_ = images = frames(2)
    for kind, more in (("image", image), ("images", images), ("volume", images)):
        adversarial = moire.AdversarialMoire(model, REGISTERED, steps=1, p=1)
        steps = A.Compose([adversarial], additional_targets={"more": kind})
        with pytest.raises(ValueError, match="'more' is an additional target of kind"):
            steps(image=image, more=more, label=1)
        assert steps(image=image, label=1)["image"].shape == image.shape


def test_a_model_of_one_channel_is_attacked_by_the_luma():
    torch.manual_seed(0)
    model = nn.Sequential(nn.Conv2d(1, 4, 3), nn.BatchNorm2d(4), nn.Flatten(), nn.Linear(480, 3))
    shown = []
    for eps in (0, 0.1):
        transform = moire.AdversarialMoire(model, REGISTERED, eps=eps, steps=2, p=1)
        steps = A.Compose([transform], seed=0)
        shown.append(steps(image=np.full((12, 14), 128, np.uint8), label=1)["image"])
    assert shown[0].shape == (12, 14) and not np.array_equal(*shown)
    assert model.training and model[1].num_batches_tracked == 0
