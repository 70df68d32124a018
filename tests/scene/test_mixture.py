"""A list of scenes: which scene each image gets, its numbers there, and its photo."""

import copy
import dataclasses
import itertools
import pickle
import re

import pytest
import torch

from moireaug import Lens, Scene, Sensor, View, capture, develop, expose
from moireaug.mixtures import Mixture, as_scene, as_scenes, map_scenes, sample_one, scenes_of
from moireaug.scene.by_name import with_values
from moireaug.scene.fields import bounds
from moireaug.scene.presets import MIXTURES, PRESETS
from moireaug.synthesis import without_moire
from moireaug.transforms import RandomMoire

NAMES = ["screen_photo", "dashcam_at_led_sign", "phone_at_laptop"]
MIXTURE = as_scenes(NAMES)
UNLIKE = as_scenes(["paper", "screen_photo"])  # whose readings differ in shape
SIZE = (16, 20)


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def pictures(n, size=SIZE):
    return torch.rand(n, 3, *size, generator=seeded(1))


def same(a, b):
    """Whether two draws of mixtures are bit for bit the same."""
    ours, theirs = a.numbers(), b.numbers()
    alike = all(torch.equal(ours[name], theirs[name]) for name in ours)
    return alike and torch.equal(a.scene_index, b.scene_index) and torch.equal(a.seed, b.seed)


@pytest.mark.parametrize("noise", [True, False])
def test_the_twins_of_a_mixture_are_those_of_its_scenes(noise):
    shot, images = MIXTURE.sample(6, SIZE, seeded()), pictures(6)
    twins = capture(images, without_moire(shot, noise=noise))
    for rows, part in shot.by_scene():
        expected = capture(images[rows], without_moire(part, noise=noise))
        assert torch.equal(twins[rows], expected)
    assert not torch.equal(twins, capture(images, shot))


def test_a_list_holds_scenes_names_and_dicts():
    own = Scene(lens=Lens(blur=0.5))
    listed = as_scenes(["paper", {"preset": "screen_photo", "lens": {"k1": 0.01}}, own])
    assert listed.scenes[0] == Scene.preset("paper") and listed.scenes[2] is own
    assert listed.scenes[1].lens.k1 == 0.01
    assert as_scenes(tuple(NAMES)) == MIXTURE and as_scenes(MIXTURE) is MIXTURE
    assert as_scenes(MIXTURE.to_dict()) == MIXTURE
    for one in ("paper", ["paper"], ("paper",), [Scene.preset("paper")]):
        assert as_scenes(one) == Scene.preset("paper")
    assert len({MIXTURE, as_scenes(NAMES), UNLIKE}) == 2
    assert pickle.loads(pickle.dumps(MIXTURE)) == copy.deepcopy(MIXTURE) == MIXTURE
    assert scenes_of(own) == (own,) and scenes_of(MIXTURE) == MIXTURE.scenes


NO_LISTS = [
    ([], ValueError, "names no scene"),
    ((), ValueError, "names no scene"),
    (["paper", ["screen_photo"]], TypeError, "got a list in it. Put all scenes into one list"),
    (["paper", MIXTURE], TypeError, "got a Mixture in it"),
    (["paper", "papers"], ValueError, "Did you mean 'paper'"),
    (["paper", "mine.yaml"], ValueError, "file is for the commands"),
    (["paper", 3], TypeError, "got int"),
    (3, TypeError, "a Scene, a preset's name or a dict, or a list of these; got int"),
    ({"paper", "screen_photo"}, TypeError, "or a list of these; got set"),
]


def test_what_is_no_list_of_scenes_is_refused():
    for scene, error, said in NO_LISTS:
        with pytest.raises(error, match=said):
            as_scenes(scene)
    with pytest.raises(TypeError, match="got list"):
        as_scene(NAMES)


def test_anywhere_is_every_screen_and_no_one_scene():
    screens = [name for name in PRESETS if not name.startswith("paper")]
    assert as_scenes("anywhere") == as_scenes(screens) == Mixture(as_scenes(screens).scenes)
    assert MIXTURES.keys().isdisjoint(PRESETS)
    assert "scene='anywhere'" in repr(RandomMoire("anywhere"))
    for one_scene in (Scene.preset, as_scene, lambda name: as_scenes(["paper", name])):
        with pytest.raises(ValueError, match=f"a mixture of {len(screens)} presets, where one"):
            one_scene("anywhere")


def test_a_larger_draw_begins_with_a_smaller_one():
    larger = MIXTURE.sample(40, SIZE, seeded())
    for n in (0, 1, 7):
        assert same(larger[:n], MIXTURE.sample(n, SIZE, seeded()))
    assert not same(larger[:7], MIXTURE.sample(7, SIZE, seeded(1)))
    torch.manual_seed(0)
    assert same(larger[:7], MIXTURE.sample(7, SIZE))


def test_scenes_are_drawn_as_often_as_they_are_named():
    n = 4000
    for weights in ((1, 1, 1), (2, 1, 1)):
        names = [name for name, weight in zip(NAMES, weights, strict=True) for _ in range(weight)]
        shot = as_scenes(names).sample(n, SIZE, seeded())
        for name, weight in zip(NAMES, weights, strict=True):
            share = weight / sum(weights)
            got = 0
            for rows, part in shot.by_scene():
                got += len(rows) * (part.scene == Scene.preset(name))
            assert abs(got - share * n) < 4 * (n * share * (1 - share)) ** 0.5


def test_each_image_lies_in_its_own_scenes_ranges():
    shot = MIXTURE.sample(60, SIZE, seeded())
    parts = shot.by_scene()
    assert sorted(torch.cat([rows for rows, _ in parts]).tolist()) == list(range(60))
    for _, part in parts:
        assert len(part.seed.unique()) == len(part)
        for name, values in part.numbers().items():
            section, field = name.split(".")
            low, high = bounds(getattr(getattr(part.scene, section), field))
            assert ((values >= low) & (values <= high)).all()
            assert not part.scene.is_drawn(name) or len(values.unique()) > 1
    # which scene says nothing of the numbers in it
    for (_, one), (_, other) in itertools.pairwise(parts):
        assert not torch.isin(one.seed, other.seed).any()


@pytest.mark.parametrize("mixture", [MIXTURE, UNLIKE], ids=["alike", "unlike"])
def test_a_draw_is_indexed_and_photographed_as_a_shot(mixture):
    shot, images = mixture.sample(9, SIZE, seeded()), pictures(9)
    photos = capture(images, shot)
    for at, part in shot.by_scene():
        assert torch.equal(photos[at], capture(images[at], part))
    for rows in (slice(2, 7), torch.arange(9) % 3 == 1, torch.tensor([8, 0, 0, 3]), [5, 4], []):
        assert torch.allclose(capture(images[rows], shot[rows]), photos[rows], atol=1e-6), rows
    twice = capture(images.repeat(2, 1, 1, 1), shot.repeat(2))
    assert torch.allclose(twice, photos.repeat(2, 1, 1, 1), atol=1e-6)
    one = shot[4]
    assert len(one) == 1 and torch.allclose(capture(images[4:5], one), photos[4:5], atol=1e-6)
    assert shot.to("cpu") is shot and len(shot) == 9 and shot.device.type == "cpu"


def test_one_image_has_a_plain_shot():
    for k in range(6):
        shot = sample_one(MIXTURE, SIZE, seeded(k))
        mixed = MIXTURE.sample(1, SIZE, seeded(k))
        assert shot.scene == MIXTURE.scenes[mixed.scene_index.item()] and len(shot) == 1
        assert torch.equal(shot.seed, mixed.seed) and shot.size == SIZE
    plain = Scene.preset("paper")
    assert torch.equal(
        sample_one(plain, SIZE, seeded()).view.yaw, plain.sample(1, SIZE, seeded()).view.yaw
    )


def test_photos_are_differentiable_and_keep_their_dtype():
    images = pictures(6).double().requires_grad_()
    shot = MIXTURE.sample(6, SIZE, seeded())
    photos = capture(images, shot)
    (gradient,) = torch.autograd.grad(photos.sum(), images)
    assert photos.dtype == torch.float64
    for at, part in shot.by_scene():
        alone = images[at].detach().requires_grad_()
        (expected,) = torch.autograd.grad(capture(alone, part).sum(), alone)
        assert torch.allclose(gradient[at], expected) and gradient[at].any()


def test_noise_is_a_list_where_readings_differ_in_shape():
    images = pictures(8)
    shot = MIXTURE.sample(8, SIZE, seeded())
    noise = 0.1 * torch.rand(shot.raw_shape(), generator=seeded())
    photos = capture(images, shot, noise)
    for at, part in shot.by_scene():
        assert torch.equal(photos[at], capture(images[at], part, noise[at]))
    assert torch.equal(capture(images, shot, list(noise)), photos)

    shot = UNLIKE.sample(8, SIZE, seeded())
    with pytest.raises(ValueError, match=r"different shapes, .*by_scene"):
        shot.raw_shape()
    shapes = {}
    for at, part in shot.by_scene():
        shapes |= dict.fromkeys(at.tolist(), part.raw_shape()[1:])
    noise = [0.1 * torch.rand(shapes[row], generator=seeded(row)) for row in range(8)]
    photos = capture(images, shot, noise)
    for at, part in shot.by_scene():
        own = torch.stack([noise[row] for row in at.tolist()])
        assert torch.equal(photos[at], capture(images[at], part, own))
    assert shot.raw_shapes() == set(shapes.values()) and len(set(shapes.values())) == 2


def test_no_image_has_no_photo_with_noise_or_without():
    shot = MIXTURE.sample(0, SIZE, seeded())
    for noise in (None, torch.zeros(shot.raw_shape()), []):
        assert capture(pictures(0), shot, noise).shape == (0, 3, *SIZE)


SHOT = MIXTURE.sample(4, SIZE, seeded())
COARSE = as_scenes(["paper", {"panel": {"width": 1.0}}])  # too coarse for a large picture
ZEROS = torch.zeros(3, dtype=torch.int64)
STRANGE = dataclasses.replace(SHOT, scene_index=SHOT.scene_index + 2)
BY_SCENE = "shot.by_scene()"
OF_FOUR = "of the 4 images of the shot; got"
REFUSED = [
    (lambda: capture(pictures(3), SHOT), ValueError, "drawn for 4 images"),
    (lambda: capture(pictures(4, (8, 8)), SHOT), ValueError, "of 16 x 20; got"),
    (lambda: capture(pictures(4)[0], SHOT), ValueError, "the shape (B, 3, H, W)"),
    (lambda: capture(pictures(4), SHOT, torch.zeros(5, 4, 16, 20)), ValueError, f"{OF_FOUR} 5"),
    (lambda: capture(pictures(4), SHOT, torch.tensor(0.1)), ValueError, f"{OF_FOUR} 0"),
    (lambda: capture(pictures(4), SHOT, torch.zeros(4, 4, 3, 3)), ValueError, "reading's shape"),
    (
        lambda: capture(pictures(4), SHOT, [*torch.zeros(3, 4, 16, 20), torch.zeros(4, 3, 3)]),
        ValueError,
        "noise[3] must have the raw reading's shape (4, 16, 20), see Shot.raw_shape(); got (4, 3",
    ),
    (lambda: capture(pictures(4), SHOT, 0.1), TypeError, "list of one for each image"),
    (lambda: expose(pictures(4), SHOT), TypeError, BY_SCENE),
    (lambda: develop(torch.zeros(4, 4, 16, 20), SHOT), TypeError, BY_SCENE),
    (lambda: SHOT.to_photo(torch.zeros(3, 1, 2)), ValueError, "each of the 4 images"),
    (lambda: SHOT.to_photo_mask(torch.zeros(5, 1, 16, 20)), ValueError, "each of the 4"),
    (lambda: SHOT[None], ValueError, "must be (B,) int64; got (1, 4)"),
    (lambda: dataclasses.replace(SHOT, scene_index=ZEROS), ValueError, "(3,) as shot.scene_index"),
    (STRANGE.by_scene, ValueError, "numbers them from 0 to 2; got"),
    (lambda: COARSE.sample(0, (8192, 8192)), ValueError, "Panel.width must be at least"),
    (lambda: sample_one(COARSE, (8192, 8192)), ValueError, "Panel.width must be"),
    (lambda: MIXTURE.sample(2.5, SIZE), ValueError, "a whole number n >= 0"),
    (lambda: MIXTURE.sample(2, (0, 4)), ValueError, "at least 1 x 1"),
    (lambda: MIXTURE.sample(2, SIZE, 3), TypeError, "must be a torch.Generator"),
]


def test_what_a_draw_does_not_fit_is_refused():
    for call, error, said in REFUSED:
        with pytest.raises(error, match=re.escape(said)):
            call()


def test_torch_compile_is_told_what_it_cannot_follow():
    images = pictures(4)
    compiled = torch.compile(lambda x: capture(x, SHOT), backend="eager", fullgraph=True)
    with pytest.raises(Exception, match="cannot follow which image is in which scene"):
        compiled(images)


def test_points_and_masks_move_where_their_own_scene_moves():
    still = Scene(view=View(roll=30.0))
    moving = with_values(still, {"develop.registered": False})
    mixture = as_scenes([still, moving])
    shot = mixture.sample(12, SIZE, seeded())
    points = torch.rand(12, 5, 2, generator=seeded()) * 10
    masks = (torch.rand(12, 2, *SIZE, generator=seeded()) > 0.5).to(torch.uint8)
    moved, carried = shot.to_photo(points), shot.to_photo_mask(masks)
    for rows, part in shot.by_scene():
        assert torch.equal(moved[rows], part.to_photo(points[rows]))
        assert torch.equal(carried[rows], part.to_photo_mask(masks[rows]))
        assert torch.equal(moved[rows], points[rows]) == (part.scene == still)
    assert mixture.moves and not as_scenes([still, "screen_photo"]).moves


def test_every_scene_is_changed():
    def brightened(scene):
        return dataclasses.replace(scene, sensor=Sensor(gain=9.0))

    changed = map_scenes(MIXTURE, brightened)
    assert isinstance(changed, Mixture) and len(changed.scenes) == 3
    assert all(one.sensor.gain == 9 for one in changed.scenes)
    assert map_scenes(MIXTURE.scenes[0], brightened) == changed.scenes[0]
