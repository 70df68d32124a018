"""The command that makes pairs, small, and what it wrote."""

import hashlib

from training import synthesise

FEW = ["n=10", "per_shard=4", "size=32", "scene=phone_at_monitor", "twin=true", "workers=0"]


def made(out, *given):
    """Run the command in this process, and return the hash of every file by its name."""
    synthesise.main([*FEW, "images=pictures", f"out={out}", *given])
    return hashes(out)


def hashes(out):
    found = {}
    for path in sorted(out.rglob("*")):
        if path.is_file() and not path.name.startswith("."):
            content = hashlib.sha256(path.read_bytes()).hexdigest()
            found[path.relative_to(out).as_posix()] = content
    return found
