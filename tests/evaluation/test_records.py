"""Records: whole lines alone, from any number of processes, whatever stopped them."""

import json
import os
import subprocess
import sys

import torch

from moireaug.evaluation.records import RecordFolder, Records, key_of

RECORD = {"key": "a", "labels": [1], "targets": [0], "predicted": [1]}
RECORD |= {"measured": {}, "seconds": 0.1, "bound": ""}


def keys(folder):
    return set(RecordFolder(folder))


def test_a_folder_keeps_whole_records_alone(tmp_path):
    one, two = RecordFolder(tmp_path), RecordFolder(tmp_path)
    one.append([RECORD])
    (first,) = tmp_path.iterdir()
    two.append([RECORD | {"key": "b"}])
    assert len(list(tmp_path.glob("records-*.jsonl"))) == 2
    with first.open("a") as file:
        file.write('{"key": "c", "predic')  # killed while it wrote
    assert "b" not in one
    one.read()
    assert "b" in one and len(one) == 2
    RecordFolder(tmp_path).append([RECORD | {"key": "c"}])
    assert keys(tmp_path) == {"a", "b", "c"}


def test_a_broken_line_is_left_out(tmp_path):
    for broken in ('{"key": "forged"}', '{"key": "b", "pre', "[1]", "7", "{}", "\x00\xff"):
        (tmp_path / "records-0.jsonl").write_text(broken + "\n" + json.dumps(RECORD) + "\n")
        assert keys(tmp_path) == {"a"}, broken


def test_reading_a_folder_writes_nothing(tmp_path):
    assert keys(tmp_path / "new") == set() and not list(tmp_path.iterdir())
    records = RecordFolder(tmp_path)
    for name in ("a", "b"):
        records.append([RECORD | {"key": name}])
    assert keys(tmp_path) == {"a", "b"} and len(list(tmp_path.glob("*.jsonl"))) == 1


def test_writers_of_one_picture_do_not_meet(tmp_path, monkeypatch):
    """Threads, and processes in containers, which all have the same process id: another one writes
    the whole picture just before this one puts its own in place."""
    monkeypatch.setattr(os, "getpid", lambda: 1)
    shown, replace = torch.rand(2, 3, 4, 4), os.replace

    def be_late(*arguments):
        monkeypatch.setattr(os, "replace", replace)
        RecordFolder(tmp_path).keep_picture("p", shown)
        replace(*arguments)

    monkeypatch.setattr(os, "replace", be_late)
    RecordFolder(tmp_path).keep_picture("p", shown)
    assert os.replace is replace and RecordFolder(tmp_path).picture("p").shape == (2, 4, 4, 3)
    assert [path.name for path in (tmp_path / "pictures").iterdir()] == ["p.png"]


PROGRAM = """
import json, os, pathlib, sys, torch
from moireaug.evaluation.identity import identity_of
from moireaug.evaluation.records import RecordFolder

keys = [identity_of(part) for part in (torch.relu, {*"abcdef"}, lambda x: x)]
folder, record = pathlib.Path(sys.argv[1]), json.loads(sys.argv[2])
RecordFolder(folder).append([record | {"key": key} for key in keys])
if len(sys.argv) > 3:
    os.kill(os.getpid(), 9)
"""


def test_a_killed_process_leaves_its_records_to_the_next(tmp_path, monkeypatch):
    """A lambda is another in every process."""
    there, arguments = tmp_path / "there", [str(tmp_path / "there"), json.dumps(RECORD)]
    env = os.environ | {"PYTHONHASHSEED": "1"}  # here it is another
    command = [sys.executable, "-c", PROGRAM, *arguments, "killed"]
    assert subprocess.run(command, env=env, check=False).returncode == -9
    assert len(keys(there)) == 3
    monkeypatch.setattr(sys, "argv", ["", *arguments])
    exec(PROGRAM, {})
    assert len(keys(there)) == 4


def test_pictures_come_back_as_they_were_kept(tmp_path):
    shown = torch.randint(0, 256, (6, 3, 5, 7)) / 255
    records = RecordFolder(tmp_path)
    records.keep_picture("p", shown)
    kept = records.picture("p")
    assert records.picture("q") is None
    assert kept.shape == (4, 5, 7, 3)
    assert torch.equal(torch.tensor(kept).permute(0, 3, 1, 2), (255 * shown[:4]).round().byte())


def test_in_memory_nothing_is_written(tmp_path):
    records = Records()
    records.append([RECORD])
    records.keep_picture("p", torch.zeros(1, 3, 2, 2))
    assert "a" in records and records["a"] == RECORD and records.picture("p") is None


def test_a_key_depends_on_the_meaning_alone():
    assert key_of({"a": 1, "b": [2.0]}) == key_of({"b": [2.0], "a": 1})
    assert key_of({"a": 1, "b": [2.0]}) != key_of({"a": 1, "b": [2.5]})
