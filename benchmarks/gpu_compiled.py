"""What the GPU's kernels are compiled to, without a GPU: a table and the times that follow."""

from __future__ import annotations

import contextlib
import functools
import importlib
import os
import re
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from torch import Tensor
from torch.profiler import ProfilerActivity, profile

from benchmarks import measure
from benchmarks.gpu_entries import ENTRIES, Case, cases, prepare_on_host
from benchmarks.sass import instruction_count

ARCHITECTURES = (80, 90)  # an A100 and an H100
BATCH, SIDE = 64, 224
# of an H100 SXM; a fused multiply-add counts as two operations
BYTES_PER_SECOND, FLOPS = 3.35e12, 67e12
ASSUMPTIONS = """\
Estimates, not measurements. No GPU was used: registers, spilled bytes, shared memory and
instructions are of the compiled kernels; the times follow for an H100 SXM whatever the kernels were
compiled for. Bytes: each array that a kernel takes is read or written once, at 3.35 TB/s.
Instructions: those that a thread executes, for each pixel of the array that the kernel fills; loops
count as often as they run ("loops"), those of unknown length once ("?"). Each is issued at the rate
of a multiply-add of float32, 33.5 T/s, float64 and special functions too. A kernel takes the longer
of the two times; launching it is left out. Peak: the most that an entry allocates at once, its
result included, in sizes of the batch of images in float32."""


class Key(NamedTuple):
    """An entry, compiled for an architecture and called with a case."""

    architecture: str
    case: str
    entry: str


class Launch(NamedTuple):
    """A kernel's compilation, and what a launch of it does.

    Args:
        registers: of a thread. spilled, shared: bytes, of a thread and of a program.
        instructions: for a pixel. loops: their lengths. megabytes: read and written.
        us: microseconds by bytes or instructions, whichever takes longer.
    """

    architecture: str
    case: str
    entry: str
    kernel: str
    registers: int
    spilled: int
    shared: int
    instructions: float
    loops: str
    megabytes: float
    us: float


class CompilingDriver:
    """A driver of Triton that has a target, and no device."""

    def __init__(self, architecture: int) -> None:
        self.architecture = architecture

    def get_current_target(self) -> Any:
        from triton.backends.compiler import GPUTarget

        return GPUTarget("cuda", self.architecture, 32)

    def get_current_device(self) -> int:
        return self.architecture  # kernels are cached by device

    def get_current_stream(self, device: int) -> int:
        return 0


@contextlib.contextmanager
def compiling(architecture: int, launched: Callable[..., None]) -> Iterator[None]:
    """Compile kernels instead of launching them, and call launched(kernel, grid, arguments)."""
    from triton.runtime import JITFunction, driver

    run = JITFunction.run

    def compile_only(
        kernel: Any, *arguments: Any, grid: Any, warmup: bool, **constants: Any
    ) -> Any:
        compiled = run(kernel, *arguments, grid=grid, warmup=True, **constants)
        launched(compiled, grid, arguments)
        return compiled

    driver.set_active(CompilingDriver(architecture))
    JITFunction.run = compile_only
    try:
        yield
    finally:
        JITFunction.run = run


def tensors(arguments: Any) -> list[Tensor]:
    """Return the tensors among arguments, which may be in tuples."""
    if isinstance(arguments, Tensor):
        return [arguments]
    if isinstance(arguments, tuple | list):
        return [tensor for argument in arguments for tensor in tensors(argument)]
    return []


def resources(compiled: Any) -> tuple[int, int, str]:
    """Return a kernel's registers, bytes on the stack, where registers are spilled, and machine
    code."""
    from triton import knobs

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "kernel.cubin"
        file.write_bytes(compiled.asm["cubin"])
        dump = [knobs.nvidia.cuobjdump.path, "-res-usage", "-sass", str(file)]
        out = subprocess.run(dump, capture_output=True, text=True, check=True).stdout
    registers, stack = re.findall(r"REG:(\d+) STACK:(\d+)", out)[0]
    return int(registers), int(stack), out


def launch_of(compiled: Any, grid: Any, arguments: Any, lengths: tuple[int, ...]) -> dict[str, Any]:
    """Return the fields of a `Launch` that do not name it."""
    registers, spilled, sass = resources(compiled)
    of_thread, loops = instruction_count(sass, lengths)
    threads = compiled.metadata.num_warps * 32
    for programs in grid:
        threads *= programs
    out = tensors(arguments)[0]
    pixels = out.shape[0] * out.shape[-2] * out.shape[-1]
    traffic = sum(tensor.nbytes for tensor in tensors(arguments))
    seconds = max(traffic / BYTES_PER_SECOND, of_thread * threads / (FLOPS / 2))
    return {
        "kernel": compiled.name,
        "registers": registers,
        "spilled": spilled,
        "shared": compiled.metadata.shared,
        "instructions": of_thread * threads / pixels,
        "loops": loops,
        "megabytes": traffic / 1e6,
        "us": seconds * 1e6,
    }


def peak_bytes(call: Callable[[], Any]) -> int:
    """Return the most bytes of tensors that a call has allocated on the CPU at once."""
    with profile(activities=[ProfilerActivity.CPU], profile_memory=True) as profiler:
        result = call()
    del result
    alive = peak = 0
    for event in sorted(profiler.events(), key=lambda event: event.time_range.start):
        alive += event.self_cpu_memory_usage
        peak = max(peak, alive)
    return peak


def launches(architecture: int, case: Case) -> tuple[list[Launch], dict[Key, float]]:
    """Return a row for each launch of each entry, and each entry's peak of memory, in batches."""
    rows: list[Launch] = []
    peaks: dict[Key, float] = {}
    for name, entry in ENTRIES.items():
        module = importlib.import_module(f"moireaug.engine.gpu.{entry.module}")

        def launched(compiled: Any, grid: Any, arguments: Any, name: str = name) -> None:
            lengths = case.loop_lengths.get(compiled.name, ())
            fields = launch_of(compiled, grid, arguments, lengths)
            rows.append(Launch(f"sm_{architecture}", case.name, name, **fields))

        with compiling(architecture, launched):
            peak = peak_bytes(functools.partial(entry.call, module, case))
        peaks[Key(f"sm_{architecture}", case.name, name)] = peak / case.images.nbytes
    return rows, peaks


def main(args: Any, facts: dict[str, Any]) -> None:
    """Print and write the table; see `gpu.main`. facts: of the machine, which are printed."""
    os.environ.pop("TRITON_INTERPRET", None)
    batch, side, architectures = (2, 32, (90,)) if args.quick else (BATCH, SIDE, ARCHITECTURES)
    rows: list[Launch] = []
    peaks: dict[Key, float] = {}
    for case in cases(batch, side)[: 1 if args.quick else None]:
        for architecture in architectures:
            of_case, peaks_of_case = launches(architecture, case)
            rows += of_case
            peaks |= peaks_of_case
    host = measure.timed_together({"host": lambda: prepare_on_host(batch, side)})["host"]
    on_host, quartiles = measure.in_ms(host._asdict())
    text = "\n\n".join(
        [
            f"{batch} photos of {side} px. {ASSUMPTIONS}",
            measure.text_of(pd.DataFrame(rows)),
            measure.text_of(totals(rows, peaks)),
            f"Drawing and lowering the default scene on the host, measured: {on_host:.1f} ms "
            f"({quartiles})",
        ]
    )
    print(text)
    (measure.results(args) / "gpu-compiled.txt").write_text(
        f"{measure.machine_lines(facts)}\n\n{text}\n"
    )
    measure.write_json(
        args,
        "gpu-compiled",
        metadata=facts,
        batch=batch,
        side=side,
        assumptions=ASSUMPTIONS,
        launches=[row._asdict() for row in rows],
        host=host._asdict(),
        peaks=[[*key, peak] for key, peak in peaks.items()],
    )


def totals(rows: list[Launch], peaks: dict[Key, float]) -> pd.DataFrame:
    """Return each entry's launches, megabytes, estimated microseconds and peak in batches."""
    groups = pd.DataFrame(rows).groupby(list(Key._fields), sort=False)
    table = groups.agg(
        launches=("kernel", "size"), megabytes=("megabytes", "sum"), us=("us", "sum")
    )
    table["peak"] = [peaks[key] for key in table.index]
    return table.reset_index()
