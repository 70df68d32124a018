"""The sweep: the same figures however the work is cut, and nothing computed twice."""

import json
import sys

import pytest
import torch
from torch import nn

from moireaug import Scene
from moireaug.evaluation import Index, Job, Judge, complete, gather, sweep
from moireaug.evaluation.rungs import CLEAN, MOIRE, NO_MOIRE, ROTATED, Rung, in_scene, moire_attack, random_noise, rival
from moireaug.evaluation.store import Store, write_text
from moireaug.evaluation.sweep import MODEL, behind, other

from .conftest import classifier

SCENE = Scene.preset("screen_photo")
EPS = 8 / 255


def hazy(images):
    """A randomised defence."""
    return (images + 0.3 * torch.rand(images.shape)).clamp(0, 1)


HAZE = behind("haze", "haze", hazy)
JOBS = complete(
    [Job(r, (MODEL, HAZE)) for r in (MOIRE, random_noise(EPS), moire_attack(EPS, 2), rival("pgd", EPS, 2, "PGD"))]
)


def run(known, places=(0, 1), jobs=JOBS, **more):
    model, batches = known
    found = sweep(model, batches.__getitem__, places, SCENE, jobs, seed=3, **more)
    return [record for new in found for record in new]


def results(records):
    """Without the time, which differs."""
    keyed = {(r["place"], r["rung"], r["judge"]): {k: v for k, v in r.items() if k != "seconds"} for r in records}
    assert len(keyed) == len(records)
    return keyed


def test_any_cut_of_the_work_gives_the_same_figures(known):
    whole = results(run(known))
    assert len(whole) == 2 * (1 + 4 * 2)  # the clean images before the model, four rungs before it and behind the haze
    shards = run(known, places=(1,)) + run(known, places=(0,))
    assert results(shards) == whole
    alone = run(known, jobs=complete([Job(random_noise(EPS), (HAZE,))]))
    assert results(alone).items() <= whole.items()


def test_another_seed_gives_others(known):
    model, batches = known
    found = sweep(model, batches.__getitem__, (0,), SCENE, JOBS, seed=4)
    other_seed = results([r for new in found for r in new])
    same = results(run(known, places=(0,)))
    assert other_seed.keys() == same.keys()
    assert other_seed[0, "clean", "model"]["targets"] != same[0, "clean", "model"]["targets"]


def test_what_is_done_is_not_done_again(known):
    calls = []

    def show(b):
        calls.append(len(b.images))
        return b.images

    jobs = complete([Job(Rung("mine", "mine", show), (MODEL, HAZE))])
    first = run(known, jobs=jobs)
    done = {(r["place"], r["rung"], r["judge"]) for r in first}
    assert calls == [8, 8]
    assert run(known, jobs=jobs, done=done) == [] and calls == [8, 8]
    half = {key for key in done if key[2] != "haze"}
    again = run(known, jobs=jobs, done=half)
    assert {r["judge"] for r in again} == {"haze"} and results(again).items() <= results(first).items()


@pytest.mark.filterwarnings("ignore:.*NVIDIA driver.*")
def test_what_does_not_fit_is_shown_in_halves(known):
    def show(b):
        if len(b.images) > 2:
            raise torch.OutOfMemoryError("too much")
        return b.images * 0.5

    (record,) = [
        r for r in run(known, (0,), complete([Job(Rung("half", "half", show), (MODEL,))])) if r["rung"] == "half"
    ]
    model, batches = known
    assert record["predicted"] == model(batches[0][0] * 0.5).argmax(1).tolist()

    def never(b):
        raise torch.OutOfMemoryError("not even one")

    with pytest.raises(torch.OutOfMemoryError, match="not even one"):
        run(known, (0,), complete([Job(Rung("never", "never", never), (MODEL,))]))


def test_success_is_counted_on_what_the_judge_has_right(known):
    def contrary(x):
        """Says the opposite of bright images."""
        return torch.where((x.mean((1, 2, 3)) > 0.5)[:, None], -1, 1) * known[0](x)

    stranger = other("stranger", contrary)
    records = run(known, jobs=complete([Job(MOIRE, (MODEL, stranger, HAZE))]))
    assert {r["judge"] for r in records if r["rung"] == "clean"} == {"model", "stranger#"}
    mine, theirs, hazed = (gather(Index(records), MOIRE, j) for j in (MODEL, stranger, HAZE))
    assert sum(mine.counted) == sum(hazed.counted) == 16  # behind a defence, the model without it counts
    theirs_clean = [r for r in records if (r["rung"], r["judge"]) == ("clean", "stranger#")]
    right = [p == y for r in theirs_clean for p, y in zip(r["predicted"], r["labels"], strict=True)]
    assert theirs.counted == right and 0 < sum(right) < 16


def test_a_target_is_another_class(known):
    for r in run(known):
        assert all(t != y and 0 <= t < 4 for t, y in zip(r["targets"], r["labels"], strict=True))


def test_rungs_of_one_scene_share_their_shots(known):
    seen = {}

    def spy(name):
        return lambda b: seen.setdefault(name, b.shot.to_dict()) and b.images

    def far(scene):
        return Scene.preset("phone_at_laptop")

    rungs = [Rung(n, n, spy(n)) for n in ("a", "b")] + [in_scene(Rung(n, n, spy(n)), "far", far) for n in ("c", "d")]
    run(known, (0,), complete([Job(r, (MODEL,)) for r in rungs]))
    assert seen["a"] == seen["b"] and seen["c"] == seen["d"] and seen["a"] != seen["c"]


def test_rotated_is_bright_and_still_turned(known):
    shown = {}
    scene = Scene.preset("paper")
    model, _ = known
    grey = torch.full((2, 3, 32, 32), 0.6)
    watch = lambda place, rung, images: shown.__setitem__(rung.name, images)  # noqa: E731
    jobs = complete([Job(r, (MODEL,)) for r in (ROTATED, NO_MOIRE)])
    list(sweep(model, lambda _: (grey, torch.zeros(2, dtype=torch.long)), [0], scene, jobs, watch=watch))
    middle = (..., slice(12, 20), slice(12, 20))
    assert torch.allclose(shown["rotated"][middle], grey[middle], atol=1e-5)
    assert torch.allclose(shown["no_moire"][middle], grey[middle] / 3, atol=1e-5)
    assert shown["rotated"][..., 0, 0].max() < 0.6 or shown["rotated"].amin() < 0.1  # the dark beside a turned screen


def test_measures_are_means_over_the_images(known):
    records = run(known, jobs=complete([Job(moire_attack(EPS, 1), (MODEL,))]))
    row = gather(Index(records), moire_attack(EPS, 1), MODEL)
    each = [r["measured"] for r in records if "measured" in r]
    assert row.to_dict()["measured"]["psnr"] == pytest.approx(sum(m["psnr"] for m in each) / 2)
    assert row.measured["largest"] > 0 and row.measured["ssim"] < 1


def test_a_model_that_returns_no_logits_gets_a_sentence(known):
    bad = Judge("bad", "bad", lambda b, shown: shown)
    with pytest.raises(ValueError, match=r"must return logits \(B, K\)"):
        run(known, (0,), complete([Job(CLEAN, (bad,))]))


def test_the_model_keeps_its_mode(known):
    model = nn.Sequential(classifier(), nn.BatchNorm1d(4)).train()
    state = {k: v.clone() for k, v in model.state_dict().items()}
    list(sweep(model, known[1].__getitem__, [0], SCENE, JOBS))
    assert model.training and all(torch.equal(v, model.state_dict()[k]) for k, v in state.items())


def test_a_store_keeps_whole_records_alone(tmp_path):
    record = {"place": 0, "rung": "clean", "judge": "model", "predicted": [1]}
    with Store(tmp_path / "s", 0) as one, Store(tmp_path / "s", 1) as two:
        one.append([record])
        two.append([record | {"place": 1}])
        with (tmp_path / "s/records-0.jsonl").open("a") as file:
            file.write('{"place": 2, "rung": "cl')  # killed while it wrote
        assert one.done() == {(0, "clean", "model"), (1, "clean", "model")}
    with Store(tmp_path / "s", 0) as again:
        again.append([record | {"place": 2}])
        assert again.done() == {(p, "clean", "model") for p in range(3)}
    assert all(json.loads(line) for line in (tmp_path / "s/records-0.jsonl").read_text().splitlines())


def test_a_broken_line_is_computed_again(tmp_path):
    record = {"place": 0, "rung": "clean", "judge": "model", "predicted": [1]}
    (tmp_path / "records-0.jsonl").write_text('{"place": 5, "rung\n' + json.dumps(record) + "\n")
    with Store(tmp_path) as store:
        assert store.done() == {(0, "clean", "model")}


@pytest.mark.skipif(sys.platform == "win32", reason="nothing is locked there")
def test_two_processes_do_not_write_one_file(tmp_path):
    with Store(tmp_path), pytest.raises(ValueError, match=r"records-0.jsonl is being written by another process"):
        Store(tmp_path)
    Store(tmp_path).__exit__()


def test_an_attempt_that_did_not_fit_leaves_no_trace(known):
    """Its random numbers are drawn again by the halves."""
    seen = []

    def show(b):
        noise = torch.rand(len(b.images), generator=b.generator), torch.rand(len(b.images))
        if len(b.images) > 4 and not seen:
            seen.append(None)
            raise torch.OutOfMemoryError("too much")
        seen.append(noise)
        return b.images

    jobs = complete([Job(Rung("mine", "mine", show), (MODEL,))])
    run(known, (0,), jobs)
    halves = seen[1:]
    seen[:] = [None]
    run(known, (0,), jobs)
    (whole,) = seen[1:]
    for k in (0, 1):
        assert torch.equal(torch.cat([h[k] for h in halves]), whole[k])


def test_a_model_without_a_choice_is_refused(known):
    with pytest.raises(ValueError, match="at least two classes apart; it returns 1 logit"):
        batch = torch.rand(2, 3, 8, 8), torch.zeros(2, dtype=torch.long)
        list(sweep(lambda x: x.mean((1, 2, 3))[:, None], lambda _: batch, [0], SCENE, JOBS))


def test_a_text_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "deep" / "page.html"
    write_text(path, "older")
    monkeypatch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        write_text(path, "newer")
    assert path.read_text() == "older" and [p.name for p in path.parent.iterdir()] == ["page.html"]
