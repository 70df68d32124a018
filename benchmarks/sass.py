"""What a thread executes, read from the machine code of an NVIDIA GPU."""

from __future__ import annotations

import re

INSTRUCTION = re.compile(r"/\*([0-9a-f]{4,})\*/\s+(.*?);")
BRANCH = re.compile(r"\bBRA\b.*?0x([0-9a-f]+)")


def instruction_count(sass: str, lengths: tuple[int, ...]) -> tuple[int, str]:
    """Return how many instructions a thread executes, and how often its loops run, as text.

    Args:
        sass: machine code, as cuobjdump prints it. lengths: of the loops in the kernel's source, in
            the order in which they begin; those left out count once.
    """
    code = [(int(at, 16), text) for at, text in INSTRUCTION.findall(sass) if text[:3] != "NOP"]
    repeats = loop_repeats(code, lengths)
    count = 0
    for at, _ in code:
        times = 1
        for (begin, end), repeat in repeats.items():
            if begin <= at <= end:
                times *= 1 if repeat is None else repeat
        count += times
    return count, " ".join("?" if repeat is None else str(repeat) for repeat in repeats.values())


def loop_repeats(
    code: list[tuple[int, str]], lengths: tuple[int, ...]
) -> dict[tuple[int, int], int | None]:
    """Return how often each loop of machine code runs, None where its length is unknown; code:
    addresses and instructions.

    A loop that is followed by one with a whole fraction of its loads is the first unrolled, and the
    second does the rest.
    """
    loops = []
    for at, text in code:
        branch = BRANCH.search(text)
        if branch and int(branch[1], 16) < at:  # a branch to itself pads the end
            loops.append((int(branch[1], 16), at))
    loops.sort(key=lambda loop: (loop[0], -loop[1]))
    loads = [sum(i <= at <= j and "LDG" in text for at, text in code) for i, j in loops]
    left, repeats = list(lengths), {}
    for k, loop in enumerate(loops):
        if loop in repeats:
            continue
        length = left.pop(0) if left else None
        repeats[loop] = length
        if length is None or k + 1 == len(loops) or loops[k + 1][0] < loop[1]:
            continue
        if loads[k + 1] and loads[k] > loads[k + 1] and loads[k] % loads[k + 1] == 0:
            unrolled = loads[k] // loads[k + 1]
            repeats[loop], repeats[loops[k + 1]] = divmod(length, unrolled)
    return repeats
