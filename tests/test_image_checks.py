"""What lies a little outside [0, 1] is clipped; what is no picture in [0, 1] is refused, and
named."""

import pytest
import torch

from moireaug import Panel, Scene, Sensor, View, capture, develop, expose

BARE = Scene(panel=Panel(layout="even"), sensor=Sensor(cfa="none"))  # needs no effects
SCENE = Scene(view=View(roll=5.0), sensor=Sensor(gain=2.0))
NORMALISATIONS = {
    "ImageNet": ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]),
    "CIFAR-10": ([0.4914, 0.4822, 0.4465], [0.247, 0.2435, 0.2616]),
    "CLIP": ([0.481, 0.458, 0.408], [0.269, 0.261, 0.276]),
    "[-1, 1]": ([0.5] * 3, [0.5] * 3),
    "mean alone": ([0.5] * 3, [1.0] * 3),
}


def normalised(images, name):
    mean, std = (torch.tensor(x).view(3, 1, 1) for x in NORMALISATIONS[name])
    return (images - mean) / std


def pictures(n=8):
    """Noise, black and white pixels, gradients and flat greys from black to white."""
    noise = torch.rand(n, 3, 24, 32)
    ramp = torch.linspace(0, 1, 32).expand(n, 3, 24, 32)
    flat = torch.linspace(0, 1, n).view(n, 1, 1, 1).expand(n, 3, 24, 32)
    return torch.cat([noise, (noise > 0.5).float(), ramp, flat])


@pytest.mark.parametrize("see", [capture, expose])
def test_a_little_outside_is_clipped(see):
    for dtype in (torch.bfloat16, torch.float32, torch.float64):
        images = (pictures(2) * 1.1 - 0.05).to(dtype)
        shot = SCENE.sample(len(images), (24, 32))
        assert images.min() < 0 and images.max() > 1
        assert torch.equal(see(images, shot), see(images.clamp(0, 1), shot))


def test_the_gradient_ends_outside_and_not_on_the_bounds():
    images = torch.rand(1, 3, 4, 4, dtype=torch.float64)
    images[0, 0, 0] = torch.tensor([-0.1, 0.0, 1.0, 1.1])
    images.requires_grad_()
    capture(images, BARE.sample(1, (4, 4))).sum().backward()
    expected = torch.ones(1, 3, 4, 4, dtype=torch.float64)
    expected[0, 0, 0] = torch.tensor([0.0, 1.0, 1.0, 0.0])
    assert torch.equal(images.grad, expected)


@pytest.mark.parametrize("name", NORMALISATIONS)
def test_a_normalised_batch_is_refused(name):
    images = normalised(pictures(), name)
    with pytest.raises(ValueError, match=r"lie in \[0, 1\].*look normalised.*attacks\.Normalized"):
        capture(images, SCENE.sample(len(images), (24, 32)))


@pytest.mark.parametrize("name", ["ImageNet", "CIFAR-10", "CLIP", "[-1, 1]"])
def test_a_nearly_flat_normalised_image_is_refused(name):
    for grey in (0.0, 0.1, 0.2, 0.3, 0.9, 1.0):
        images = normalised((grey + 0.02 * torch.randn(1, 3, 24, 32)).clamp(0, 1), name)
        if images.min() >= 0 and images.max() <= 1:
            assert name == "[-1, 1]", "what is in [0, 1] cannot be told from a picture"
        else:
            with pytest.raises(ValueError, match="look normalised"):
                capture(images, SCENE.sample(1, (24, 32)))


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda x: normalised(x, "ImageNet"), "values from -[^ ]* to [^ ]* in image 2, which look"),
        (lambda x: x * 255, "in image 2, which look like 0 to 255. Divide them by 255"),
        (lambda x: x * 65535, "in image 2, which look like 0 to 65535. Divide them by 65535"),
        (lambda x: torch.full_like(x, torch.nan), "finite.*NaN in image 2"),
        (lambda x: x.masked_fill(x > 0.99, torch.nan), "finite.*NaN in image 2"),
        (lambda x: x.masked_fill(x > 0.99, torch.inf), "finite.*infinity in image 2"),
        (lambda x: -x.masked_fill(x > 0.99, torch.inf), "finite.*infinity in image 2"),
        (lambda x: x + torch.randn_like(x), "noisier"),
    ],
)
def test_one_bad_image_of_a_batch_is_named(spoil, sentence):
    images = torch.rand(4, 3, 24, 32)
    images[2] = spoil(images[2])
    for dtype in (torch.float32, torch.float64, torch.bfloat16):
        with pytest.raises(ValueError, match=sentence):
            capture(images.to(dtype), SCENE.sample(4, (24, 32)))


@pytest.mark.parametrize("scene", [Scene(), SCENE], ids=["frontal", "turned"])
def test_a_raw_reading_belongs_to_its_shot(scene):
    shot = scene.sample(4, (8, 12))
    raw = expose(torch.rand(4, 3, 8, 12), shot)
    assert develop(raw, shot).shape == (4, 3, 8, 12)
    for other in (raw[:1], raw[:, :3], raw[..., :-1], raw[0]):
        with pytest.raises(ValueError, match="raw must"):
            develop(other, shot)
    for other in ((raw * 255).long(), raw.numpy()):
        with pytest.raises(TypeError, match="raw must"):
            develop(other, shot)
