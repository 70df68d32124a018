"""Pictures of one target are the frames of a video that a hand films, or a tripod in the camera's
frame; frame i has the shot's seed + i for the noise."""

import albumentations as A
import numpy as np
import pytest
import torch
from torchvision import tv_tensors

from moireaug import Shot
from moireaug.attacks import MoireAttack
from moireaug.capture import capture
from moireaug.scene.by_name import with_values
from moireaug.scene.track import DEFAULT_HAND, TRIPOD, track_of
from moireaug.transforms import albumentations as moire
from moireaug.transforms import torchvision
from moireaug.transforms._convert import shot_of_frames
from tests.transforms.common import CAMERA, FRAMES, REGISTERED

SHAPE = (9, 12, 3)
LEADS = {"image": (), "images": (3,), "volume": (3,)}


@pytest.fixture
def repeated():
    """(4, 9, 12, 3): one picture four times."""
    picture = np.random.default_rng(0).random(SHAPE).astype(np.float32)
    return np.repeat(picture[None], 4, 0)


def of_target(target, pictures):
    lead = LEADS[target]
    return pictures[: int(np.prod(lead))].reshape(*lead, *SHAPE)


def photos_by_hand(picture, shot, n):
    frames = track_of(shot, [n], TRIPOD if shot.moves else DEFAULT_HAND)
    assert torch.equal(frames.seed, shot.seed + torch.arange(n))
    return np.stack([moire.apply_to_one(picture, frames[i]) for i in range(n)])


@pytest.mark.parametrize("frame", ["registered", "camera"])
def test_a_target_s_pictures_differ_in_sensor_noise(frame, repeated):
    steps = A.ReplayCompose([moire.RandomMoire(FRAMES[frame], p=1)])
    for target in LEADS:
        out = steps(**{target: of_target(target, repeated)})
        shot = Shot.from_dict(out["replay"]["transforms"][0]["params"]["shot"])
        photos = out[target].reshape(-1, *SHAPE)
        assert np.array_equal(photos, photos_by_hand(repeated[0], shot, len(photos))), target
        assert len({photo.tobytes() for photo in photos}) == len(photos)


def test_a_video_s_frames_are_those_of_images(repeated):
    shot = REGISTERED.sample(1, SHAPE[:2], torch.Generator().manual_seed(0))
    video = tv_tensors.Video(torch.from_numpy(repeated).permute(0, 3, 1, 2))
    frames = torchvision.apply_shot(video, shot).permute(0, 2, 3, 1).numpy()
    assert np.array_equal(frames, moire.apply_to_all(repeated, shot))
    assert np.array_equal(frames, photos_by_hand(repeated[0], shot, 4))


def test_without_sensor_noise_a_tripod_s_frames_are_alike(repeated):
    quiet = with_values(CAMERA, {"sensor.read_noise": 0.0})
    photos = A.Compose([moire.RandomMoire(quiet, p=1)], seed=0)(images=repeated)["images"]
    assert np.array_equal(photos, np.repeat(photos[:1], 4, 0)) and np.any(photos != repeated)


def test_masks_stay_where_the_camera_s_frame_has_its_video():
    shot = CAMERA.sample(1, SHAPE[:2], torch.Generator().manual_seed(0))
    frames = shot_of_frames(shot, [3])
    assert torch.equal(frames.matrix(), shot.repeat(3).matrix())


def test_the_masks_of_a_volume_move_alike(repeated):
    mask = np.ones((4, 9, 12), np.uint8)
    out = A.Compose([moire.RandomMoire(CAMERA, p=1)])(volume=repeated, mask3d=mask)
    assert np.array_equal(out["mask3d"], np.repeat(out["mask3d"][:1], 4, 0))


@pytest.mark.parametrize("targets", [["images"], ["image", "images", "volume"]], ids=str)
def test_the_photos_are_those_that_the_attack_found(targets, repeated, monkeypatch):
    model = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(3 * 9 * 12, 3))
    adversarial = moire.AdversarialMoire(model, REGISTERED, eps=0.1, steps=2, p=1)
    found, in_scenes = [], MoireAttack.in_scenes

    def recorded(attack, run, images, labels, targets, shot, generator):
        noise = in_scenes(attack, run, images, labels, targets, shot, generator)
        found.append(capture(images, shot, noise))
        return noise

    monkeypatch.setattr(MoireAttack, "in_scenes", recorded)
    steps = A.Compose([adversarial], is_check_shapes=False, seed=0)
    out = steps(**{target: of_target(target, repeated) for target in targets}, label=1)
    photos = np.concatenate([out[target].reshape(-1, *SHAPE) for target in targets])
    assert np.array_equal(photos, found[0].permute(0, 2, 3, 1).numpy())
