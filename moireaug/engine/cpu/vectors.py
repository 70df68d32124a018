"""Loads and stores declared not to overlap, so that LLVM vectorises a loop; sums of rows; and sums
over the cells that a pixel sees, in vectors of tap weights.

Plain loops in place of the latter take, on 8 photos of 224 px with AVX-512, 1.3 times as long in
the camera's frame, and 1.05 to 1.6 for full readings: frontal, and turned.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from moireaug.engine.cpu.compiling import jit_in_place
from moireaug.engine.cpu.records import TapWeights

SUMS_AT_ONCE = 4  # of `add_four_sums`
LANES = 16  # float32 that loops work on at once; rows are padded to a multiple


def _is_row(array) -> bool:
    return isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"


def _is_row_of(dtype, *arrays) -> bool:
    return all(_is_row(array) and array.dtype == dtype for array in arrays)


def _is_tap_weights(record) -> bool:
    return isinstance(record, types.NamedTuple) and record.instance_class is TapWeights


class _Emitter:
    """Writes the code of a call, of arguments that are counted from 0."""

    def __init__(self, context, builder, argument_types, args) -> None:
        self.context, self.builder = context, builder
        self.types, self.args = argument_types, args

    def index(self, i: int) -> ir.Value:
        """Return argument i as an index."""
        return self.context.cast(self.builder, self.args[i], self.types[i], types.intp)

    def address(self, i: int, index: ir.Value) -> ir.Value:
        """Return where an element of the array in argument i is."""
        array = self.context.make_array(self.types[i])(self.context, self.builder, self.args[i])
        return self.builder.gep(array.data, [index], inbounds=True)

    def load(self, i: int, index: ir.Value) -> ir.Value:
        """Return an element."""
        data_type = self.context.get_data_type(self.types[i].dtype)
        return self.builder.load(self.address(i, index), typ=data_type)

    def scope(self) -> ir.MDValue:
        """Return the alias scope of the function that is being compiled.

        It refers to itself, which makes it unlike any other: where LLVM puts a function into a
        caller twice, each copy gets a scope of its own.
        """
        function, module = self.builder.function, self.builder.module
        if not hasattr(function, "alias_scopes"):
            domain = module.add_metadata(["moireaug"])
            scope = module.add_metadata([function.name, domain])
            function.alias_scopes = module.add_metadata([scope])
            scope.operands = scope, domain
        return function.alias_scopes

    def offset(self, index: ir.Value, by: int) -> ir.Value:
        """Return an index further on."""
        return self.builder.add(index, ir.Constant(index.type, by))

    def vector(self, i: int, index: ir.Value, lanes: int) -> ir.Value:
        """Return neighbouring float32, aligned or not."""
        kind = ir.VectorType(ir.FloatType(), lanes)
        pointer = self.builder.bitcast(self.address(i, index), kind.as_pointer())
        value = self.builder.load(pointer, typ=kind)
        value.align = 4
        return value

    def store_vector(self, value: ir.Value, i: int, index: ir.Value) -> None:
        """Store neighbouring float32, aligned or not."""
        pointer = self.builder.bitcast(self.address(i, index), value.type.as_pointer())
        self.builder.store(value, pointer).align = 4

    def lanes(self, vector: ir.Value, chosen: list[int]) -> ir.Value:
        """Return some lanes of a vector, as a vector."""
        order = ir.Constant(ir.VectorType(ir.IntType(32), len(chosen)), chosen)
        return self.builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), order)

    def broadcast(self, scalar: ir.Value, lanes: int) -> ir.Value:
        """Return a vector with one number in all lanes."""
        none = ir.Constant(ir.VectorType(ir.FloatType(), 1), ir.Undefined)
        first = ir.Constant(ir.IntType(32), 0)
        return self.lanes(self.builder.insert_element(none, scalar, first), [0] * lanes)

    def fma(self, a: ir.Value, b: ir.Value, c: ir.Value) -> ir.Value:
        """Return a * b + c, rounded once."""
        kind = ir.FunctionType(a.type, [a.type] * 3)
        name = f"llvm.fma.v{a.type.count}f32"
        function = cgutils.get_or_insert_function(self.builder.module, kind, name)
        return self.builder.call(function, [a, b, c])

    def between(self, a: ir.Value, b: ir.Value, share: ir.Value) -> ir.Value:
        """Return what lies a share of the way from a to b; share: a number."""
        shares = self.broadcast(share, a.type.count)
        return self.fma(shares, self.builder.fsub(b, a), a)

    def total(self, vector: ir.Value) -> ir.Value:
        """Return the sum of a vector."""
        apart = vector.type.count // 2
        while apart:
            other = self.lanes(vector, [i ^ apart for i in range(vector.type.count)])
            vector, apart = self.builder.fadd(vector, other), apart // 2
        return self.builder.extract_element(vector, ir.Constant(ir.IntType(32), 0))

    def tap_weights(self, i: int, pixel: ir.Value, taps: int) -> ir.Value:
        """Return a pixel's tap weights, from the TapWeights in argument i."""
        fields = [self.builder.extract_value(self.args[i], k) for k in range(len(self.types[i]))]
        of = _Emitter(self.context, self.builder, self.types[i].types, fields)
        here = self.builder.sext(of.load(2, pixel), ir.IntType(64))
        # a phase's weights and the next one's lie side by side
        there = self.builder.add(here, of.index(1))
        here, there = of.vector(0, here, 2 * taps), of.vector(0, there, 2 * taps)
        both = self.between(here, there, of.load(4, pixel))
        first, second = (self.lanes(both, list(range(start, start + taps))) for start in (0, taps))
        return self.between(first, second, of.load(3, pixel))


@intrinsic
def load(typing, array, index):
    """Return array[index] of a contiguous one-dimensional array that no `store` of the same
    function writes to, nor did when the same line called the function before, as in a loop.

    The index must be in range, and not negative.
    """

    def emit(context, builder, signature, args):
        code = _Emitter(context, builder, signature.args, args)
        value = code.load(0, code.index(1))
        value.set_metadata("noalias", code.scope())
        return value

    return (array.dtype(array, index), emit) if _is_row(array) else None


@intrinsic
def store(typing, array, index, value):
    """Set array[index] = value, of an array that no `load` of the same function reads."""

    def emit(context, builder, signature, args):
        code = _Emitter(context, builder, signature.args, args)
        value = context.cast(builder, args[2], signature.args[2], signature.args[0].dtype)
        stored = builder.store(value, code.address(0, code.index(1)))
        stored.set_metadata("alias.scope", code.scope())
        return context.get_dummy_value()

    return (types.none(array, index, value), emit) if _is_row(array) else None


def tap_weights_storing(taps: int):
    """Make an intrinsic that stores a pixel's `taps` tap weights."""

    @intrinsic
    def store_weights(typing, out, weights, pixel):
        """Fill out[taps * pixel ...]; weights: a TapWeights."""

        def emit(context, builder, signature, args):
            code = _Emitter(context, builder, signature.args, args)
            pixel = code.index(2)
            start = builder.mul(pixel, ir.Constant(pixel.type, taps))
            code.store_vector(code.tap_weights(1, pixel, taps), 0, start)
            return context.get_dummy_value()

        accepts = _is_row_of(types.float32, out) and _is_tap_weights(weights)
        return (types.none(out, weights, pixel), emit) if accepts else None

    return store_weights


def content_weighing(taps: int):
    """Make an intrinsic that weighs `taps` x `taps` cells of a panel for a pixel."""

    @intrinsic
    def content_of(typing, panel, base, stride, weights, down, pixel):
        """Return the sum of panel[base[pixel] + j * stride + i] * across[i] *
        down[taps * pixel + j]; across: the pixel's tap weights, from a TapWeights."""

        def emit(context, builder, signature, args):
            code = _Emitter(context, builder, signature.args, args)
            stride, pixel = code.index(2), code.index(5)
            start = builder.mul(pixel, ir.Constant(pixel.type, taps))
            row = builder.sext(code.load(1, pixel), ir.IntType(64))
            total = None
            for j in range(taps):
                weight = code.broadcast(code.load(4, code.offset(start, j)), taps)
                cells = code.vector(0, row, taps)
                is_first = total is None
                total = builder.fmul(weight, cells) if is_first else code.fma(weight, cells, total)
                row = builder.add(row, stride)
            return code.total(builder.fmul(total, code.tap_weights(3, pixel, taps)))

        accepts = _is_row_of(types.float32, panel, down) and _is_row_of(types.int32, base)
        kinds = panel, base, stride, weights, down, pixel
        return (types.float32(*kinds), emit) if accepts and _is_tap_weights(weights) else None

    return content_of


def content_adding(taps: int):
    """Make the transpose of what `content_weighing` makes: neighbours add to the same cells."""

    @intrinsic
    def add_content(typing, panel, base, stride, across, down, grad, pixel):
        """Add grad[pixel] * across[taps * pixel + i] * down[taps * pixel + j] to
        panel[base[pixel] + j * stride + i]."""

        def emit(context, builder, signature, args):
            code = _Emitter(context, builder, signature.args, args)
            stride, pixel = code.index(2), code.index(6)
            start = builder.mul(pixel, ir.Constant(pixel.type, taps))
            across, grad = code.vector(3, start, taps), code.load(5, pixel)
            row = builder.sext(code.load(1, pixel), ir.IntType(64))
            for j in range(taps):
                weight = builder.fmul(grad, code.load(4, code.offset(start, j)))
                cells = code.vector(0, row, taps)
                code.store_vector(code.fma(code.broadcast(weight, taps), across, cells), 0, row)
                row = builder.add(row, stride)
            return context.get_dummy_value()

        floats = _is_row_of(types.float32, panel, across, down, grad)
        kinds = panel, base, stride, across, down, grad, pixel
        return (types.none(*kinds), emit) if floats and _is_row_of(types.int32, base) else None

    return add_content


@jit_in_place
def add_sum(out, coefficients, rows, offsets):
    """Add the sum over l of coefficients[l] * rows[offsets[l] + i] to out[i] (n,).

    coefficients, offsets: (taps,) float32 and int64. rows: flat float32.
    """
    for l in range(len(offsets)):
        add(out, rows[offsets[l] : offsets[l] + len(out)], coefficients[l])


@jit_in_place
def add_four_sums(out, coefficients, rows, offsets):
    """Add four sums of the same rows to out (4 * n,): to pixel i of sum j the sum over l of
    coefficients[j, l] * rows[offsets[l] + i].

    coefficients: (4 * t,), of which the first taps of each t are used. The rest as in `add_sum`.
    """
    n, each = len(out) // SUMS_AT_ONCE, len(coefficients) // SUMS_AT_ONCE
    for j in range(SUMS_AT_ONCE):
        add_sum(out[j * n : (j + 1) * n], coefficients[j * each : (j + 1) * each], rows, offsets)


@jit_in_place
def padded_width(n):
    """Return the length of a row of n values, padded to whole LANES."""
    return (n + LANES - 1) // LANES * LANES


@jit_in_place
def add(out, row, factor):
    """Add factor * row to out, (n,) each."""
    for i in range(len(out)):
        store(out, i, out[i] + factor * load(row, i))


@jit_in_place
def gather(out, row, index, weight):
    """Fill out (n,) with sums over taps of weight[t] * row[index[t]]."""
    for t in range(len(index)):
        _add_gathered(out, row, index[t], weight[t], t == 0)


@jit_in_place
def _add_gathered(out, row, index, weight, first):
    if first:
        for i in range(len(out)):
            store(out, i, load(weight, i) * load(row, load(index, i)))
    else:
        for i in range(len(out)):
            store(out, i, out[i] + load(weight, i) * load(row, load(index, i)))
