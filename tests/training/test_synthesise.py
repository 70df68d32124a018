"""The command that makes pairs: the same bytes however shared, interrupted or read."""

import csv
import errno
import io
import json
import multiprocessing
import os
import re
import resource
import signal
import tarfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from moireaug import Shot, capture, develop
from moireaug.camera.effects.srgb import codes_of_light
from moireaug.scene.by_name import with_values
from tests.synthesis.folders import put, spoil
from tests.training.forked import LONG
from tests.training.pairs import FEW, hashes, made
from training import synthesise
from training.pairs import files as pair_files

UNDONE = ("shoulder", "contrast", "chroma_blur", "sharpen", "jpeg")  # of a development
FORKS = multiprocessing.get_context("fork")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return put(tmp_path / "pictures")


def leftovers(out):
    return [path.name for path in out.iterdir() if path.name.endswith(".tmp")]


@pytest.fixture(params=["webdataset", "imagefolder"])
def form(request):
    return f"format={request.param}"


def test_the_bytes_are_the_same_however_the_work_is_shared(tmp_path, form, folder):
    spoil(folder)
    whole = made(tmp_path / "whole", form)
    file_count = 3 if form == "format=webdataset" else 10 * 3 + 3
    assert sum(name.startswith("00000") for name in whole) == file_count
    for share in ("2/3", "0/3", "1/3"):
        made(tmp_path / "shared", form, f"shard={share}")
    assert hashes(tmp_path / "shared") == whole
    with ThreadPoolExecutor(2) as pool:  # at once
        jobs = []
        for k in range(2):
            cfg = synthesise.configure([*FEW, form, "images=pictures", "out=once", f"shard={k}/2"])
            jobs.append(pool.submit(synthesise.synthesise, cfg))
    assert [job.result() for job in jobs] == [None, None] and hashes(tmp_path / "once") == whole
    other = made(tmp_path / "other", form, "seed=1")
    assert not set(other.values()) & set(whole.values())


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")  # Python 3.12 and newer
def test_a_killed_command_loses_the_running_file_alone(tmp_path, capsys):
    given = ["images=pictures", "out=killed", *FEW, "n=80", "workers=1"]
    killed, done = tmp_path / "killed", tmp_path / "killed/000001.tar"
    process = FORKS.Process(target=synthesise.main, args=(given,))
    process.start()
    while not done.exists():
        assert process.is_alive()
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGSTOP)
    with pytest.raises(SystemExit, match="another command is at work on shard=0/1 of killed"):
        synthesise.main([*given, "workers=0"])
    process.kill()
    process.join(LONG)  # its worker ends some seconds later
    kept = hashes(killed)
    times = {name: (killed / name).stat().st_mtime_ns for name in kept}
    assert len(kept) < 21, "nothing was left to go on with"
    assert len(leftovers(killed)) <= 1
    synthesise.main([*given, "workers=0"])
    assert not leftovers(killed)
    for name in kept:
        assert (killed / name).stat().st_mtime_ns == times[name], "a whole file was made again"
    assert hashes(killed) == made(tmp_path / "straight", "n=80")
    capsys.readouterr()
    synthesise.main([*given, "workers=0"])
    assert "killed is complete: 80 pairs in 20 files." in capsys.readouterr().out


def read_by_libraries(out):
    """Compare what the usual libraries read; in a process of its own, as they are large."""
    os.environ |= {"HF_DATASETS_OFFLINE": "1", "HF_HUB_OFFLINE": "1", "HF_HOME": f"{out}/home"}
    import webdataset
    from datasets import load_dataset

    table = load_dataset("imagefolder", data_dir=f"{out}/folders")["train"]
    streamed = load_dataset("imagefolder", data_dir=f"{out}/folders", streaming=True)["train"]
    tars = [f"{out}/tars/{number:06d}.tar" for number in range(3)]
    tuples = webdataset.WebDataset(tars, shardshuffle=False).decode("rgb8")
    pairs = {item["__key__"]: item for item in tuples}
    names = ["photo", "original", "twin"]
    assert len(pairs) == 10
    assert table.column_names == [*names, "index", "picture", "top", "left", "shot", "moire"]
    for row, again in zip(table, streamed, strict=True):
        pair = pairs.pop(f"{row['index']:06d}")
        for name in names:
            assert np.array_equal(np.asarray(row[name]), pair[name + ".png"]), name
            assert np.array_equal(np.asarray(row[name]), np.asarray(again[name])), name
        assert json.loads(row["shot"]) == pair["json"]["shot"]
        assert row["picture"] == pair["json"]["picture"]
    assert not pairs


@pytest.mark.filterwarnings("ignore")  # as for the libraries' users
def test_webdataset_and_datasets_read_the_files_as_they_are(tmp_path):
    made(tmp_path / "tars")
    made(tmp_path / "folders", "format=imagefolder")
    process = FORKS.Process(target=read_by_libraries, args=(tmp_path,))
    process.start()
    process.join(LONG)
    assert process.exitcode == 0


def test_what_is_written_replays(tmp_path):
    made(tmp_path / "out")
    with tarfile.open(tmp_path / "out/000002.tar") as tar:
        files = {member.name: tar.extractfile(member).read() for member in tar}
        headers = {(m.mtime, m.uid, m.gid, m.uname, m.mode) for m in tar.getmembers()}
    assert headers == {(0, 0, 0, "", 0o644)}
    names = ["photo.png", "original.png", "twin.png", "json"]
    assert list(files) == [f"{k:06d}.{name}" for k in (8, 9) for name in names]

    def codes(name):
        with Image.open(io.BytesIO(files[name])) as picture:
            return torch.from_numpy(np.array(picture)).permute(2, 0, 1)

    shot = Shot.from_dict(json.loads(files["000009.json"])["shot"])
    photo = capture(codes("000009.original.png")[None].float() / 255, shot)[0]
    assert torch.equal(codes("000009.photo.png"), (photo * 255).round().to(torch.uint8))


@pytest.mark.parametrize("scene", ["phone_at_dimmed_phone", "full.yaml"])
def test_a_raw_reading_develops_to_the_photo(tmp_path, scene):
    Path("full.yaml").write_text("panel: {scale: 2.0}\nsensor: {scale: 1.5, gain: 1.3}\n")
    made(tmp_path / "out", "raw=true", f"scene={scene}", "n=2", "encoding=png")
    with tarfile.open(tmp_path / "out/000000.tar") as tar:
        files = {member.name: tar.extractfile(member).read() for member in tar}
    reading = np.load(io.BytesIO(files["000001.raw.npy"]))
    facts = json.loads(files["000001.json"])
    shot, raw = Shot.from_dict(facts["shot"]), facts["raw"]
    assert reading.dtype == np.uint16 and (1, *reading.shape) == shot.raw_shape()
    with Image.open(io.BytesIO(files["000001.photo.png"])) as picture:
        photo = torch.from_numpy(np.array(picture)).permute(2, 0, 1)
    light = torch.from_numpy(reading.astype(np.float32) / raw["white_level"])
    developed = (develop(light[None], shot)[0] * 255).round()
    assert (developed - photo).abs().max() <= 1
    assert raw["planes"] == ["R", "G", "G", "B"] and raw["black_level"] == 0
    assert raw["binned"] == (scene != "full.yaml") == raw["linear"]
    assert raw["exposure_time"] == (shot.sensor.shutter.item() or None)
    # what stands beside it is what development reads
    red, _, blue = raw["white_balance"]
    assert (red, blue) == (shot.develop.red.item(), shot.develop.blue.item())
    grey = torch.full((1, 4, *reading.shape[1:]), 0.2)
    plain = with_values(shot, {f"develop.{name}": torch.zeros(1) for name in UNDONE})
    balanced = torch.tensor([[0.2 * red, 0.2, 0.2 * blue]]) @ torch.tensor(raw["colour_matrix"]).T
    expected = codes_of_light(balanced) if raw["linear"] else balanced
    middle = develop(grey, plain)[0, :, 12:20, 12:20].mean((1, 2))
    assert torch.allclose(middle, expected[0].float(), atol=3e-3)


def test_raw_readings_lie_in_folders_and_are_part_of_the_settings(tmp_path):
    made(tmp_path / "out", "raw=true", "format=imagefolder", "n=2")
    with (tmp_path / "out/000000/metadata.csv").open() as table:
        row = next(csv.DictReader(table))
    assert (tmp_path / "out/000000" / row["raw_file"]).exists()
    assert json.loads(row["raw"])["white_level"] == 65535
    with pytest.raises(SystemExit, match="raw: True there, False now"):
        made(tmp_path / "out", "format=imagefolder", "n=2")


def test_moire_is_told_and_written_beside_twins(tmp_path, capsys):
    strengths = []
    for shrink in ("null", "[1,3]"):
        out = tmp_path / shrink
        made(out, "format=imagefolder", f"shrink={shrink}")
        said = capsys.readouterr().out
        sentence = r"Moiré of the first 10 pairs, photo minus the same without: median (\S+) codes"
        told = float(re.search(sentence, said)[1])
        written = []
        for path in sorted(out.glob("*/metadata.csv")):
            with path.open(newline="") as file:
                written += [float(row["moire"]) for row in csv.DictReader(file)]
        assert float(f"{np.median(written):.2g}") == told
        strengths.append(told)
    assert strengths[0] < 1 < strengths[1]
    scene = json.loads((out / "dataset.json").read_text())["settings"]["scene"]
    assert scene["sensor"]["shrink"] == [1, 3]
    made(tmp_path / "plain", "format=imagefolder", "twin=false")
    assert "Moiré of the first 10 pairs" in capsys.readouterr().out
    assert "moire" not in next((tmp_path / "plain").glob("*/metadata.csv")).read_text()
    with pytest.raises(ValueError, match="shrink"):
        synthesise.configure([*FEW, "images=pictures", "out=out", "shrink=[1,"])


def test_encodings_keep_what_they_promise():
    pairs = synthesise.Pairs("pictures", "phone_at_monitor", 32)
    photo = pairs.make_pair(3).photo.permute(1, 2, 0).numpy()
    for given, name, most in (
        (["encoding=webp"], "photo.webp", 0),
        (["encoding=webp", "quality=90"], "photo.webp", 12),
        (["encoding=jpeg"], "photo.jpg", 4),
        (["encoding=jpeg", "quality=30"], "photo.jpg", 20),
    ):
        cfg = synthesise.configure([*FEW, "images=pictures", "out=out", *given])
        item = pair_files.EncodedPairs(pairs, cfg.encoding, cfg.quality, cfg.raw)[3]
        with Image.open(io.BytesIO(item.files[name])) as picture:
            error = np.sqrt(((np.array(picture).astype(float) - photo) ** 2).mean())
        assert (error == 0) == (most == 0) and error <= most, given


def test_a_full_disk_gets_a_sentence_and_work_resumes(tmp_path, monkeypatch, form, capsys):
    out, real = tmp_path / "out", os.fsync

    def full(file):
        if any(out.glob("000001*")):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(file)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(SystemExit) as end:
        made(out, form)
    assert str(end.value.code).startswith("error: ")
    assert "000002" in end.value.code and "could not be written (No space left" in end.value.code
    assert "MB are free. Every whole file is kept. Make room" in end.value.code
    assert not leftovers(out) and not list(out.glob("000002*")) and any(out.glob("000001*"))
    monkeypatch.setattr(os, "fsync", real)
    assert made(out, form) == made(tmp_path / "straight", form)


def test_a_file_size_limit_leaves_no_half_written_file(tmp_path, form):
    """The kernel itself refuses to write on."""
    made(tmp_path / "out", form, "shard=0/3")
    before = hashes(tmp_path / "out")
    _, hard = limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2_000, hard))
    try:
        with pytest.raises(SystemExit, match="could not be written"):
            made(tmp_path / "out", form)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert hashes(tmp_path / "out") == before and not leftovers(tmp_path / "out")


def test_an_interruption_keeps_whole_files_and_says_so(tmp_path, monkeypatch, capsys):
    encode, out = pair_files.encode, tmp_path / "out"

    def interrupt(*given):
        if (out / "000000.tar").exists():
            raise KeyboardInterrupt
        return encode(*given)

    monkeypatch.setattr(pair_files, "encode", interrupt)
    with pytest.raises(SystemExit) as end:
        made(out)
    assert end.value.code == 130 and "the same command continues" in capsys.readouterr().err
    assert not leftovers(out) and [p.name for p in out.glob("0*")] == ["000000.tar"]


def test_skipped_pictures_are_named_and_counted(tmp_path, folder, capsys):
    spoil(folder)
    (folder / os.fsdecode(b"caf\xe9.txt")).write_text("a name in Latin-1")
    made(tmp_path / "out", "n=40", "per_shard=40", "twin=false")
    said = capsys.readouterr()
    assert "3 pictures were skipped, see above; others were drawn instead." in said.out
    assert "not pictures by their names: 2, caf?.txt, notes.txt." in said.out
    assert "40 pairs in " in said.out and " pairs per second." in said.out
    for name in ("torn.png", "words.jpg", "low.png"):
        assert said.err.count(name) == 1
