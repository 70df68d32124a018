"""A command of several kinds, of which its first word names one."""

import importlib
from collections.abc import Mapping, Sequence

from training.system.messages import prepare_output


def run_subcommand(
    script: str, description: str | None, modules: Mapping[str, str], argv: Sequence[str]
) -> None:
    """Run the `main` of the module that the first word names; --help alone names them all.

    Args:
        modules: module by word; only the one that runs is imported.

    Raises:
        SystemExit: the command has failed, or there is none of that name.
    """
    prepare_output()
    if argv and argv[0] in modules:
        importlib.import_module(modules[argv[0]]).main(argv[1:])
    elif {"-h", "--help"} & set(argv):
        print((description or "").strip())
    else:
        got = repr(argv[0]) if argv else "nothing"
        raise SystemExit(f"error: {script} takes {' or '.join(modules)} first; got {got}.")
