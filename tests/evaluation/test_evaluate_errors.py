"""What `evaluate` refuses, with a sentence and before it writes a file."""

import pytest
import torch
from torch.utils.data import DataLoader, TensorDataset

from moireaug.defenses import JPEG, Compose
from moireaug.evaluation import evaluate


@pytest.fixture
def loader(known):
    images, labels = (torch.cat(parts) for parts in zip(*known[1], strict=True))
    return DataLoader(TensorDataset(images, labels), batch_size=8)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"suite": "lader"}, "suite must be one of .* got 'lader'. Did you mean 'ladder'"),
        ({"loader": []}, "loader yields no images"),
        ({"loader": [{"image": 1}]}, "must yield .images, labels.; got a dict"),
        ({"scene": "nowhere"}, "nowhere"),
        (
            {"model": lambda x: x.mean((1, 2, 3)), "folder": "out"},
            "nothing tells the model, a function",
        ),
        (
            {"defences": {"mine": lambda x: x}, "folder": "out", "suite": "adaptive"},
            "nothing tells mine, a function",
        ),
        (
            {"targets": {"other": lambda x: x}, "folder": "out", "suite": "transfer"},
            "nothing tells other, a function",
        ),
        ({"identity": 3, "folder": "out"}, "identity must be a text that .* the model; got 3"),
        ({"identity": "", "folder": "out"}, "identity must be a text"),
        ({"targets": {"other": torch.nn.Identity()}}, "targets= is for suite=transfer or trust"),
        ({"defences": {"mine": torch.relu}}, "defences= is for suite=.*suite=ladder has no use"),
        (
            {"defences": {"mine": torch.relu}, "suite": "noise_position"},
            "suite=noise_position has no row for a defence 'mine', but for jpeg_20, jpeg_40. Use",
        ),
        (
            {"defences": {"bits_4": torch.relu}, "suite": "adaptive"},
            "suite=adaptive has no row for a defence 'bits_4', .* Give yours another name, and it",
        ),
        (
            {"defences": {"mine": JPEG}, "suite": "defences"},
            "mine must be a function .* to images; got",
        ),
        (
            {"targets": {"other": torch.nn.Linear(1, 1, device="meta")}, "suite": "transfer"},
            r"other is on meta, the model on cpu: pass other.to\('cpu'\)",
        ),
        (
            {"defences": {"d": Compose((torch.nn.Linear(1, 1, device="meta"),))}},
            "d is on meta, the model on cpu",
        ),
        ({"networks": {"mine": torch.relu}}, "networks= is for suite=demoireing or paper"),
        ({"eps": 0.1, "suite": "unseen"}, "eps= is for suite=ladder.*suite=unseen has no use"),
        ({"eps": 0.1, "suite": "recipes"}, "suite=recipes has no use for it"),
        ({"lpips": "alexnet.pth", "suite": "unseen"}, "lpips= is for .*suite=unseen has no use"),
        (
            {"targets": {"model": torch.nn.Identity()}},
            "'model' cannot name a target, defence or network",
        ),
        ({"eps": ()}, "eps must be a number >= 0 in .0, 1. units, or a list of them; got"),
        ({"eps": (4 / 255, 4 / 255)}, "eps must be one or more different bounds"),
        ({"n": 0}, "n must be an integer >= 1, how many images, or None for all; got 0"),
        ({"n": 2.0}, "n must be an integer >= 1"),
        ({"eps": (8,)}, "eps is in .0, 1. units, where 1 is full scale; got 8"),
        ({"eps": "a"}, "eps must be a number >= 0"),
        ({"steps": 1.5}, "steps must be an integer >= 0"),
        ({"seed": 1.5}, "seed must be an integer >= 0"),
        (
            {"loader": [(torch.rand(2, 3, 8, 8), torch.zeros(4).long())], "n": 1},
            "one label per image; got 4 labels for 2 images",
        ),
        ({"loader": None}, "loader must yield batches of .images, labels.; got a NoneType"),
        (
            {"loader": [(torch.rand(3, 8, 8), torch.tensor(0))]},
            r"labels .B,.; got .3, 8, 8. and ... Wrap single images: DataLoader",
        ),
        (
            {"loader": [(torch.rand(2, 3, 8, 8), torch.eye(2))]},
            r"labels .B,., one class each; got .2, 2.. Pass labels.argmax.1. if they are one-hot",
        ),
        (
            {"loader": [(torch.rand(2, 3, 8, 8), torch.zeros(2, 1).long())]},
            r"one class each; got .2, 1.. Pass labels\[:, 0\]\.",
        ),
        ({"loader": [(torch.rand(1, 3, 8, 8), 3)]}, "labels .B,.; got .1, 3, 8, 8. and ..[.]"),
        (
            {"loader": [(torch.rand(1, 3, 8, 8), torch.zeros(1), torch.zeros(1))]},
            r"got a tuple of 3. Wrap it: ..b.0., b.1.. for b in loader",
        ),
        ({"loader": (torch.rand(2, 3, 8, 8), torch.zeros(2).long())}, "a single batch into a list"),
        ({"loader": [(torch.rand(1, 3, 8, 8), torch.tensor([9]))]}, r"model's classes; got 9"),
        (
            {"model": lambda x: {"logits": x.mean((2, 3))}},
            r"got a dict of 'logits'.*model\(images\)\['logits'\]",
        ),
        ({"model": torch.nn.Linear}, "model must be a function or a torch module"),
        ({"targets": {"other": 3}}, "other must be a function or a torch module"),
        ({"model": torch.nn.Linear(3, 3).half()}, "has weights of torch.float16 and does not take"),
        ({"loader": [(torch.rand(0, 3, 8, 8), torch.zeros(0).long())]}, "loader yields no images"),
        ({"loader": [(torch.rand(2, 8, 8, 3), torch.zeros(2).long())]}, "3, H, W"),
    ],
)
def test_mistakes_get_a_sentence(known, loader, change, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call = {"model": known[0], "loader": loader, "progress": False} | change
    with pytest.raises((ValueError, TypeError), match=message):
        evaluate(**call)
    assert not list(tmp_path.iterdir())
