"""Transforms with a list of scenes: each image is photographed in one of them."""

from dataclasses import replace

import albumentations as A
import numpy as np
import pytest
import torch
from kornia.augmentation import AugmentationSequential
from torchvision import tv_tensors

from moireaug import Develop, Lens, Panel, Scene, Sensor, Shot, View, capture
from moireaug.attacks import MoireAttack
from moireaug.mixtures import as_scenes
from moireaug.nn import ScreenCamera
from moireaug.transforms import AdversarialMoire, RandomMoire, albumentations, kornia

# no range and no noise, so that each image has one photo in each
DARK = Scene(panel=Panel(scale=1.2), view=View(roll=10.0), sensor=Sensor(gain=1.5))
BRIGHT = Scene(panel=Panel(scale=0.9), sensor=Sensor(gain=3.0))
TURNED = Scene(view=View(roll=20.0), develop=Develop(registered=False))
LISTED = [DARK, BRIGHT]
HAND_ERROR = 0.03  # by which frames that a hand films differ from the first, at most


def which(photos, images, scenes=LISTED, error=1e-6):
    """Index of the scene that each photo is taken in, to a mean error; -1 for the image itself."""
    found, taken = [], [images, *(scene.capture(images) for scene in scenes)]
    for row, photo in enumerate(photos):
        near = [k - 1 for k, one in enumerate(taken) if (photo - one[row]).abs().mean() < error]
        assert len(near) == 1
        found += near
    return found


TRANSFORMS = {"torchvision": RandomMoire, "kornia": kornia.RandomMoire}


@pytest.fixture
def many():
    return torch.rand(16, 3, 16, 20, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize("library", TRANSFORMS)
def test_each_chosen_image_is_in_one_of_the_scenes(library, many):
    for p, scenes in ((0.0, {-1}), (0.5, {-1, 0, 1}), (1.0, {0, 1})):
        transform = TRANSFORMS[library](LISTED, p=p)
        torch.manual_seed(0)
        photos = transform(many)
        assert set(which(photos, many)) == scenes
        torch.manual_seed(0)
        assert torch.equal(transform(many), photos)


def test_a_videos_frames_share_their_scene(many):
    video = tv_tensors.Video(many.reshape(4, 4, 3, 16, 20))
    photos = RandomMoire(LISTED, p=1)(video).reshape(16, 3, 16, 20)
    found = which(photos, many, error=HAND_ERROR)
    assert [len(set(found[k : k + 4])) for k in range(0, 16, 4)] == [1] * 4


def test_masks_move_with_their_own_scene():
    images = torch.rand(12, 3, 24, 24, generator=torch.Generator().manual_seed(2))
    masks = tv_tensors.Mask(torch.ones(12, 1, 24, 24, dtype=torch.uint8))
    transform = RandomMoire([BRIGHT, TURNED], p=1)
    torch.manual_seed(1)
    photos, moved = transform(images, masks)
    turned = torch.tensor(which(photos, images, [BRIGHT, TURNED])) == 1
    assert 0 < turned.sum() < 12
    # a turned picture leaves the photo's corners dark
    assert torch.equal((moved == 0).flatten(1).any(1), turned)


def test_kornia_refuses_lists_with_the_cameras_frame():
    with pytest.raises(ValueError, match="registered=True"):
        kornia.RandomMoire([BRIGHT, TURNED])
    assert kornia.RandomMoire([BRIGHT, TURNED], images_only=True).images_only


def test_kornia_replays_a_draw_bit_for_bit(many):
    names = ["screen_photo", "dashcam_at_led_sign"]
    chain = AugmentationSequential(kornia.RandomMoire(names, p=0.7), data_keys=["input"])
    photos = chain(many)
    assert torch.equal(chain(many, params=chain._params), photos)
    (params,) = chain._params
    assert set(params.data["scene"].tolist()) == {0, 1}


def test_kornia_shares_one_scene_on_the_batch(many):
    transform = kornia.RandomMoire(LISTED, p=1, same_on_batch=True)
    found = [which(transform(many[:4]), many[:4]) for _ in range(8)]
    assert all(len(set(one)) == 1 for one in found) and {one[0] for one in found} == {0, 1}


def test_kornia_replays_no_draw_of_another_kind(many):
    for drawn, replayed, said in (
        ("screen_photo", LISTED, "drawn by a transform of one scene"),
        (LISTED, "screen_photo", "drawn by a transform of a list of scenes"),
        (Scene(), "screen_photo", "got .* Its scene states .*: draw from it"),
    ):
        params = kornia.RandomMoire(drawn, p=1).forward_parameters(many.shape)
        with pytest.raises(ValueError, match=said):
            kornia.RandomMoire(replayed, p=1)(many, params=params)


IMAGE = np.random.default_rng(0).random((16, 20, 3), np.float32)


def test_albumentations_draws_a_scene_for_each_call():
    batch = torch.from_numpy(IMAGE).permute(2, 0, 1)[None]
    transform = A.Compose([albumentations.RandomMoire(LISTED, p=1)], seed=3)
    found = []
    for _ in range(8):
        photo = torch.from_numpy(transform(image=IMAGE)["image"]).permute(2, 0, 1)[None]
        found += which(photo, batch)
    assert set(found) == {0, 1}
    # all pictures of one call are in one scene
    stacked = transform(images=np.stack([IMAGE] * 3))["images"]
    assert np.abs(stacked[1:] - stacked[0]).mean((1, 2, 3)).max() < HAND_ERROR


PRINTED = [
    ("screen_photo", None, "'screen_photo'"),
    ("anywhere", None, "'anywhere'"),
    ("screen_photo", 2.0, "'screen_photo', shrink=2.0"),
    ("anywhere", (1, 3), "'anywhere', shrink=(1.0, 3.0)"),
    (["phone_at_laptop", "screen_photo"], 3, "['phone_at_laptop', 'screen_photo'], shrink=3.0"),
]


@pytest.mark.parametrize(("scene", "shrink", "text"), PRINTED)
def test_presets_print_as_they_were_asked_for(scene, shrink, text):
    for transform in (RandomMoire, kornia.RandomMoire, albumentations.RandomMoire):
        assert f"scene={text}" in repr(transform(scene, shrink=shrink))
    assert f"ScreenCamera({text}, jitter=0)" == repr(ScreenCamera(scene, shrink=shrink))


def test_scenes_that_no_preset_and_shrink_gives_print_their_fields():
    crops = Scene.preset("screen_photo").with_shrink(2)
    others = Scene.preset("phone_at_laptop").with_shrink(3)
    for scene in (crops.with_shrink((2, 3)), replace(crops, lens=Lens(blur=0.5))):
        assert ", shrink=" not in repr(RandomMoire([scene, others]))
        assert "sensor.shrink=" in repr(RandomMoire([scene, others]))


def test_albumentations_writes_and_replays_a_list():
    moire = albumentations.RandomMoire(["screen_photo", "phone_at_laptop"], p=1)
    assert "scene=['screen_photo', 'phone_at_laptop']" in repr(moire)
    written = A.from_dict(A.to_dict(A.Compose([moire])))
    assert written.transforms[0].scene == moire.scene
    chain = A.ReplayCompose([moire])
    for _ in range(4):
        photo = chain(image=IMAGE)
        again = A.ReplayCompose.replay(photo["replay"], image=IMAGE)["image"]
        assert np.array_equal(again, photo["image"])


class Slopes(torch.nn.Module):
    """Two classes by a fixed pattern: every noise that helps helps more where it is greater."""

    def forward(self, x):
        pattern = torch.linspace(-1, 1, x[0].numel()).sin().reshape(x[0].shape)
        score = (x * pattern).sum((1, 2, 3))
        return torch.stack([score, -score], 1)


def test_adversarial_moire_attacks_each_image_in_its_scene(many):
    labels = torch.arange(16) % 2
    settings = {"eps": 8 / 255, "steps": 2, "random_start": 0.0}
    adversarial = AdversarialMoire(Slopes(), LISTED, **settings)
    photos, given = adversarial(many, labels, generator=torch.Generator().manual_seed(0))
    assert given is labels
    g = torch.Generator().manual_seed(0)
    torch.rand(16, generator=g)  # which images are chosen
    shot = as_scenes(LISTED).sample(16, (16, 20), g)
    for rows, part in shot.by_scene():
        attack = MoireAttack(Slopes(), scene=part.scene, **settings)
        expected = attack.last(many[rows], labels[rows], shot=part)
        assert torch.equal(photos[rows], expected)
        assert not torch.allclose(photos[rows], capture(many[rows], part))
    assert len(shot.by_scene()) == 2 and "scene=[Scene(" in repr(adversarial)
    with pytest.raises(ValueError, match="would not move with the images"):
        mask = tv_tensors.Mask(torch.ones(16, 16, 20))
        AdversarialMoire(Slopes(), [BRIGHT, TURNED])({"x": many, "m": mask, "labels": labels})


def test_adversarial_moire_of_albumentations_attacks_in_the_scene_it_drew():
    moire = albumentations.AdversarialMoire(Slopes(), LISTED, p=1, eps=8 / 255, steps=2)
    chain = A.ReplayCompose([moire])
    chain.set_random_seed(1)
    scenes = set()
    for _ in range(6):
        attacked = chain(image=IMAGE, label=1)
        shot = Shot.from_dict(attacked["replay"]["transforms"][0]["params"]["shot"])
        scenes.add(shot.scene)
        photo = torch.from_numpy(albumentations.apply_to_one(IMAGE, shot)).permute(2, 0, 1)[None]
        shown = torch.from_numpy(attacked["image"]).permute(2, 0, 1)[None]
        assert Slopes()(shown)[0, 1] < Slopes()(photo)[0, 1]
        again = A.ReplayCompose.replay(attacked["replay"], image=IMAGE)["image"]
        assert np.allclose(again, attacked["image"], atol=1e-6)
    assert scenes == set(LISTED)
