"""Run a program as if only the core dependencies of moireaug were installed.

python core_alone.py DISTRIBUTION,... PROGRAM
"""

import re
import sys
from importlib import metadata


def normalised(name):
    return re.sub(r"[-_.]+", "-", name).lower()


def required(names):
    """Return distributions and what they require, extras left out."""
    found = set()
    waiting = list(names)
    while waiting:
        name = normalised(waiting.pop())
        if name in found:
            continue
        try:
            requirements = metadata.requires(name) or []
        except metadata.PackageNotFoundError:  # of another platform, or an optional one
            continue
        found.add(name)
        for requirement in requirements:
            if "extra ==" not in requirement:
                waiting.append(re.match(r"[\w.-]+", requirement).group())
    return found


def hide_all_but(core):
    """Hide every installed module that the core's distributions neither are nor require."""
    allowed = required(core) | {"moireaug"}
    for module, owners in metadata.packages_distributions().items():
        if not allowed & {normalised(owner) for owner in owners}:
            sys.modules.setdefault(module, None)  # which is found nowhere


if __name__ == "__main__":
    hide_all_but(sys.argv[1].split(","))
    exec(sys.argv[2])
