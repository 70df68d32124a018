"""torch.compile takes the whole capture as one graph, for a scene whose plan is known. On the CPU,
the graph calls the engine; where a photo would have the reference, it follows that."""

import dataclasses
import math
import pickle

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, capture, develop, expose
from moireaug.engine import operators, reference
from moireaug.engine.cpu import run
from moireaug.scene.by_name import with_values

SCENES = {
    "released chain": Scene.preset("paper_code"),
    "binned": Scene.preset("screen_photo"),
    "everything": Scene(
        panel=Panel(scale=0.9, layout="pentile", pwm=200.0), view=View(yaw=10.0),
        lens=Lens(blur=0.5, olpf=0.3, vignetting=0.3, k1=0.02),
        sensor=Sensor(
            scale=2.0, gain=2.0, shutter=0.01, readout=0.02, read_noise=0.01, shot_noise=0.01,
            bits=8,
        ),
        develop=Develop(
            demosaic="malvar", red=1.1, linear_light=True, denoise="bilateral", jpeg=80.0,
            chroma_blur=0.6, sharpen=0.3, sharpen_radius=0.7,
        ),
    ),
}  # fmt: skip
# without what "everything" has, as each operation of the reference is traced
PLAIN_BINS = Scene(
    panel=Panel(width=40.0), view=View(roll=5.0), lens=Lens(blur=0.3), sensor=Sensor(pitch=2.0)
)
SIZE = (16, 24)

pytestmark = pytest.mark.filterwarnings("ignore:Dynamo detected a call to a `functools.lru_cache`")


@pytest.fixture(autouse=True)
def _forget():
    torch._dynamo.reset()


def compiled(function, backend="eager"):
    """The graph is traced and run as it is: what a compiler makes of it is not ours to test."""
    return torch.compile(function, fullgraph=True, backend=backend)


def seen_by(name):
    return torch.rand(2, 3, *SIZE), SCENES[name].sample(2, SIZE)


@pytest.mark.parametrize("name", ["binned", "everything"])
def test_a_graph_gives_the_photo_of_the_engine(name):
    images, shot = seen_by(name)
    called = []

    def noted(graph, _):
        called.extend(str(node.target) for node in graph.graph.nodes)
        return graph

    assert torch.equal(compiled(capture, noted)(images, shot), capture(images, shot))
    assert {"moireaug.expose", "moireaug.develop"} <= set(called)


def test_a_graph_knows_a_part_that_is_the_whole():
    # the photo of a part is not dark around
    images, shot = torch.rand(2, 3, *SIZE), with_values(PLAIN_BINS, {"view.zoom": 0.5})
    shot = dataclasses.replace(shot, develop=Develop(registered=False)).sample(2, SIZE)
    part = shot.crop(0, 0, *SIZE)
    assert not torch.equal(capture(images, part), capture(images, shot))
    assert torch.equal(compiled(capture)(images, part), capture(images, part))


def test_a_graph_gives_the_photo_of_the_reference():
    images, shot = seen_by("everything")
    with reference():
        expected = capture(images, shot)
        assert torch.allclose(compiled(capture)(images, shot), expected, atol=1e-5)


def test_a_graph_that_calls_the_engine_heeds_the_switch():
    images, shot = seen_by("everything")
    graph = compiled(capture)
    graph(images, shot)
    with reference():
        assert torch.equal(graph(images, shot), capture(images, shot))


def test_a_graph_has_the_engines_gradient_in_the_reading():
    images, shot = seen_by("everything")
    raw, weight = expose(images, shot).requires_grad_(), torch.rand_like(images)
    # the backend that differentiates the graph
    photo = compiled(develop, "aot_eager")(raw, shot)
    (found,) = torch.autograd.grad((photo * weight).sum(), raw)
    (wanted,) = torch.autograd.grad((develop(raw, shot) * weight).sum(), raw)
    assert torch.equal(found, wanted) and wanted.any()


def test_a_gradient_takes_what_its_graph_kept_and_computes_what_it_did_not(monkeypatch):
    images, shot = seen_by("binned")
    raw, launches = expose(images, shot).requires_grad_(), []
    launch = run.launch_develop
    monkeypatch.setattr(run, "launch_develop", lambda *a: launches.append(1) or launch(*a))
    graph = compiled(develop)
    photos = [graph(raw, shot) for _ in range(operators.MAX_KEPT + 1)]
    for photo, launched in ((photos[-1], 0), (photos[0], 1)):
        launches.clear()
        (found,) = torch.autograd.grad(photo.square().sum(), raw)
        assert len(launches) == launched
    (wanted,) = torch.autograd.grad(develop(raw, shot).square().sum(), raw)
    assert torch.equal(found, wanted) and wanted.any()


def test_a_graph_has_a_gradient_in_the_image():
    images, released = torch.rand(2, 3, *SIZE), SCENES["released chain"]
    shot = with_values(released, {"develop.denoise": "nlm"}).sample(2, SIZE)
    shown = images.requires_grad_()
    found, wanted = (
        torch.autograd.grad(function(shown, shot).square().sum(), shown)[0]
        for function in (compiled(capture), capture)
    )
    assert torch.allclose(found, wanted, atol=1e-6) and wanted.any()


def test_a_graph_under_vmap_follows_the_reference():
    images, shot = torch.rand(2, 3, *SIZE), PLAIN_BINS.sample(2, SIZE)

    def both(batches):
        return torch.func.vmap(lambda images: capture(images, shot))(batches)

    batches = torch.stack([images, images.flip(0)])
    found = torch.compile(both, backend="eager")(batches)
    with reference():
        expected = torch.stack([capture(batch, shot) for batch in batches])
    assert torch.allclose(found, expected, atol=1e-5)


def test_every_further_shot_of_a_scene_takes_the_same_graph(monkeypatch):
    monkeypatch.setattr(torch._dynamo.config, "error_on_recompile", True)
    graph, images = compiled(capture), torch.rand(2, 3, *SIZE)
    shots = [
        SCENES["released chain"].sample(2, SIZE, torch.Generator().manual_seed(i)) for i in (0, 1)
    ]
    for shot in (*shots, pickle.loads(pickle.dumps(shots[1]))):  # as from a worker
        assert torch.equal(graph(images, shot), capture(images, shot))


def test_a_graph_moves_a_shot_to_its_images_device():
    _, shot = seen_by("released chain")
    moved = compiled(lambda image: shot.to(image.device))
    assert moved(torch.empty(1, device="meta")).device.type == "meta"


def test_a_scene_must_be_planned_before_its_graph():
    images, shot = seen_by("released chain")
    scene = pickle.loads(pickle.dumps(shot.scene))
    photograph = compiled(scene.capture)
    with pytest.raises(torch._dynamo.exc.Unsupported, match=r"call scene\.plan\(size\) before"):
        photograph(images)
    scene.plan(shot.size)
    assert photograph(images).shape == images.shape


@pytest.mark.parametrize("value", [torch.nan, torch.inf])
def test_a_graph_gives_no_photo_of_what_is_no_number(value):
    images, shot = seen_by("released chain")
    images[0] = value
    photo = compiled(capture)(images, shot)
    assert photo[0].isnan().any() == math.isnan(value)
    assert torch.allclose(photo[1:], capture(images[1:], shot[1:]), atol=1e-3)
    assert torch.is_grad_enabled()
