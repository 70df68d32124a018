"""What a thread executes, read from the machine code of an NVIDIA GPU."""

from __future__ import annotations

import re
from dataclasses import dataclass

INSTRUCTION = re.compile(r"/\*([0-9a-f]{4,})\*/\s+(.*?);")
BRANCH = re.compile(r"\bBRA\b.*?0x([0-9a-f]+)")
Code = list[tuple[int, str]]  # addresses and instructions


@dataclass
class Loop:
    """A loop of machine code.

    Args:
        begin, end: addresses of its first and its last instruction.
        loads: number of loads from global memory in it.
        repeats: how often it runs; None where its length is unknown.
    """

    begin: int
    end: int
    loads: int
    repeats: int | None = None

    def holds(self, address: int) -> bool:
        return self.begin <= address <= self.end


def instruction_count(sass: str, lengths: tuple[int, ...]) -> tuple[int, str]:
    """Return how many instructions a thread executes, and how often its loops run, as text.

    Args:
        sass: machine code, as cuobjdump prints it.
        lengths: of the loops in the kernel's source, in the order in which they begin; those left
            out count once.
    """
    code = []
    for address, text in INSTRUCTION.findall(sass):
        if not text.startswith("NOP"):
            code.append((int(address, 16), text))
    loops = loops_of(code)
    set_repeats(loops, lengths)
    count = 0
    for address, _ in code:
        executions = 1
        for loop in loops:
            if loop.holds(address) and loop.repeats is not None:
                executions *= loop.repeats
        count += executions
    return count, " ".join("?" if loop.repeats is None else str(loop.repeats) for loop in loops)


def loops_of(code: Code) -> list[Loop]:
    """Return the loops of machine code in the order in which they begin, outer ones first."""
    loops = []
    for end, text in code:
        branch = BRANCH.search(text)
        if branch is None:
            continue
        begin = int(branch[1], 16)
        if begin < end:  # a branch to itself pads the end
            loads = sum("LDG" in text for address, text in code if begin <= address <= end)
            loops.append(Loop(begin, end, loads))
    return sorted(loops, key=lambda loop: (loop.begin, -loop.end))


def set_repeats(loops: list[Loop], lengths: tuple[int, ...]) -> None:
    """Give the loops their lengths, in order, as far as these reach.

    A loop that is followed by one with a whole fraction of its loads is the first unrolled, and the
    second does the rest.
    """
    following = [*loops, None][1:]
    is_rest = False
    left = list(lengths)
    for loop, rest in zip(loops, following, strict=True):
        if is_rest:
            is_rest = False
            continue
        if not left:
            return
        loop.repeats = left.pop(0)
        if rest is not None and is_rest_of(rest, loop):
            loop.repeats, rest.repeats = divmod(loop.repeats, loop.loads // rest.loads)
            is_rest = True


def is_rest_of(rest: Loop, unrolled: Loop) -> bool:
    if rest.begin < unrolled.end or rest.loads == 0:
        return False
    return unrolled.loads > rest.loads and unrolled.loads % rest.loads == 0
