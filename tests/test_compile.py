"""torch.compile takes the whole capture as one graph, for a scene whose plan is known."""

import pytest
import torch

from moireaug import Develop, Lens, Panel, Scene, Sensor, View, capture
from moireaug.engine.dispatch import reference

SCENES = {
    "released chain": Scene.preset("paper_code"),
    "everything": Scene(
        panel=Panel(scale=0.9, layout="pentile", pwm=200.0),
        view=View(yaw=10.0),
        lens=Lens(blur=0.5, olpf=0.3, vignetting=0.3, k1=0.02),
        sensor=Sensor(
            scale=2.0,
            gain=2.0,
            shutter=0.01,
            readout=0.02,
            read_noise=0.01,
            shot_noise=0.01,
            bits=8,
        ),
        develop=Develop(
            demosaic="malvar", red=1.1, linear_light=True, denoise="bilateral", jpeg=80.0
        ),
    ),
}


@pytest.mark.filterwarnings("ignore:Dynamo detected a call to a `functools.lru_cache`")
@pytest.mark.parametrize("name", SCENES)
def test_one_graph_gives_the_same_photo(name):
    torch._dynamo.reset()
    images, shot = torch.rand(2, 3, 16, 24), SCENES[name].sample(2, (16, 24))
    # the graph is traced and run as it is: what a compiler makes of it is not ours to test
    compiled = torch.compile(capture, fullgraph=True, backend="eager")
    with reference():  # which the graph is of
        expected = capture(images, shot)
    assert torch.allclose(compiled(images, shot), expected, atol=1e-5)


@pytest.mark.filterwarnings("ignore:Dynamo detected a call to a `functools.lru_cache`")
def test_every_further_shot_of_a_scene_takes_the_same_graph(monkeypatch):
    torch._dynamo.reset()
    monkeypatch.setattr(torch._dynamo.config, "error_on_recompile", True)
    scene, images = SCENES["released chain"], torch.rand(2, 3, 16, 24)
    compiled = torch.compile(capture, fullgraph=True, backend="eager")
    for seed in range(3):
        shot = scene.sample(2, (16, 24), torch.Generator().manual_seed(seed))
        assert torch.allclose(compiled(images, shot), capture(images, shot), atol=1e-5)


def test_a_graph_moves_a_shot_to_its_images_device():
    torch._dynamo.reset()
    shot = SCENES["released chain"].sample(2, (16, 24))
    moved = torch.compile(lambda image: shot.to(image.device), fullgraph=True, backend="eager")
    assert moved(torch.empty(1, device="meta")).device.type == "meta"
