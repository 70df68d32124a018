"""What `evaluate` refuses, with a sentence and before it writes a file."""

import re

import torch
from torch import nn

from moireaug.defenses import JPEG, Compose
from moireaug.evaluation import evaluate
from moireaug.evaluation.suites.ladder import ladder
from tests.attacks.common import refusal

IMAGES, ONE = torch.rand(2, 3, 8, 8), torch.zeros(1).long()
ELSEWHERE = nn.Linear(1, 1, device="meta")


def unknown(images):
    return images


def of(*batches):
    return {"loader": list(batches)}


REFUSED = [
    ({"suite": "lader"}, "suite must be one of .* got 'lader'. Did you mean 'ladder'"),
    ({"scene": "nowhere"}, "nowhere"),
    ({"model": unknown, "folder": "out"}, "nothing tells the model, a function"),
    (
        {"defences": {"mine": unknown}, "folder": "out", "suite": "adaptive"},
        "nothing tells mine, a function",
    ),
    (
        {"targets": {"other": unknown}, "folder": "out", "suite": "trust"},
        "nothing tells other, a function",
    ),
    ({"identity": 3, "folder": "out"}, "identity must be a text that .* the model; got 3"),
    ({"identity": "", "folder": "out"}, "identity must be a text"),
    ({"targets": {"other": nn.Identity()}}, "targets= is for suite=trust"),
    ({"targets": [nn.Identity()]}, r"targets must be a dict, by name; got \[Identity"),
    ({"defences": JPEG()}, "defences must be a dict, by name; got JPEG"),
    ({"targets": {"other": 3}}, "other must be a function or a torch module"),
    ({"targets": {"model": nn.Identity()}}, "'model' cannot name a target or a defence"),
    (
        {"targets": {"other": ELSEWHERE}, "suite": "trust"},
        r"other is on meta, the model on cpu: pass other.to\('cpu'\)",
    ),
    ({"defences": {"mine": unknown}}, "defences= is for suite=.*suite=ladder has no use"),
    (
        {"defences": {"mine": unknown}, "suite": ladder},
        "suite=ladder has no row for a defence 'mine', but for . Use one",
    ),
    (
        {"defences": {"bits_4": unknown}, "suite": "adaptive"},
        "suite=adaptive has no row for a defence 'bits_4', .* Give yours another name, and it",
    ),
    ({"defences": {"mine": JPEG}, "suite": "adaptive"}, "mine must be a function .* to images"),
    ({"defences": {"d": Compose((ELSEWHERE,))}}, "d is on meta, the model on cpu"),
    ({"suite": lambda config: 3}, r"suite must return a moireaug.evaluation.Table, .*; got 3"),
    ({"suite": 3}, "suite must be one of 'ladder', .*; got 3"),
    ({"eps": 0.1, "suite": "unseen"}, "eps= is for suite=ladder.*suite=unseen has no use"),
    ({"eps": 0.1, "suite": "recipes"}, "suite=recipes has no use for it"),
    ({"lpips": "alexnet.pth", "suite": "unseen"}, "lpips= is for .*suite=unseen has no use"),
    ({"eps": ()}, "eps must be one or more different bounds, in .0, 1. units; got"),
    ({"eps": (4 / 255, 4 / 255)}, "eps must be one or more different bounds"),
    ({"eps": (8,)}, "eps is in .0, 1. units, where 1 is full scale; got 8"),
    ({"eps": "a"}, "eps must be a number >= 0"),
    ({"n": 0}, "n must be a whole number of at least 1, how many images, or None for all; got 0"),
    ({"n": 2.0}, "n must be a whole number of at least 1"),
    ({"steps": 1.5}, "steps must be a whole number of at least 0"),
    ({"seed": 1.5}, "seed must be a whole number of at least 0"),
    ({"model": nn.Linear}, "model must be a function or a torch module"),
    ({"model": nn.Linear(3, 3).half()}, "has weights of torch.float16 and does not take"),
    ({"model": lambda x: {"logits": x.mean((2, 3))}}, r"model\(images\)\['logits'\]"),
    ({"loader": None}, "loader must yield batches of .images, labels.; got a NoneType"),
    ({"loader": (IMAGES, ONE.repeat(2))}, "a single batch into a list"),
    (of(), "loader yields no images"),
    (of({"image": 1}), "must yield .images, labels.; got a dict"),
    (of((IMAGES, torch.zeros(4).long())) | {"n": 1}, "got 4 labels for 2 images"),
    (of((IMAGES[0], ONE[0])), r"got .3, 8, 8. and ... Wrap single images: DataLoader"),
    (of((IMAGES, torch.eye(2))), r"got .2, 2.. Pass labels.argmax.1. if they are one-hot"),
    (of((IMAGES, ONE.repeat(2, 1))), r"one class each; got .2, 1.. Pass labels\[:, 0\]\."),
    (of((IMAGES[:1], 3)), "labels .B,.; got .1, 3, 8, 8. and ..[.]"),
    (of((IMAGES[:1], ONE, ONE)), r"got a tuple of 3. Wrap it: ..b.0., b.1.. for b in loader"),
    (of((IMAGES[:1], ONE + 9)), r"model's classes; got 9"),
    (of((IMAGES[:0], ONE[:0])), "loader yields no images"),
    (of((IMAGES.permute(0, 2, 3, 1), ONE.repeat(2))), "3, H, W"),
]


def test_mistakes_get_a_sentence(known, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model, loader = known
    for change, message in REFUSED:
        call = {"model": model, "loader": loader, "progress": False} | change
        said = refusal(lambda call=call: evaluate(**call))
        assert re.search(message, said), f"{said!r} is not {message!r}"
        assert not list(tmp_path.iterdir()), message


def test_settings_are_refused_before_a_batch_is_read(known, tmp_path):
    read = []

    def batches():
        read.append(True)
        yield from known[1]

    for change in (
        {"suite": "laddder"},
        {"eps": 0.1, "suite": "unseen"},
        {"defences": {"mine": JPEG(20)}, "suite": "ladder"},
        {"lpips": tmp_path / "missing.pth"},
        {"model": unknown, "folder": tmp_path / "out"},
    ):
        call = {"model": known[0], "loader": batches(), "progress": False} | change
        assert refusal(lambda call=call: evaluate(**call)) and not read, change
