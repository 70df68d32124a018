"""Two results of benchmarks/speed.py beside each other."""

import json

from benchmarks import compare


def result(path, **ratios):
    rows = [{"what": name, "against": "JPEG", "ratio": ratio} for name, ratio in ratios.items()]
    path.write_text(json.dumps({"rows": rows}))
    return str(path)


def test_what_has_become_slower_is_found(tmp_path, capsys):
    old = result(tmp_path / "old.json", capture=0.2, gone=1.0, alone=None)
    assert compare.main(old, result(tmp_path / "same.json", capture=0.25, new=9.0, alone=None)) == 0
    assert "1.25" in capsys.readouterr().out
    assert compare.main(old, result(tmp_path / "slow.json", capture=0.4)) == 1
    assert compare.main(old, result(tmp_path / "other.json", new=0.4)) == 1  # nothing to compare
