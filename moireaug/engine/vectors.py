"""Loads and stores declared not to overlap, so that LLVM vectorises a loop; and vectorised sums of
rows."""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from moireaug.engine.compiling import inner
from moireaug.engine.record import LANES


def _scope(builder: ir.IRBuilder) -> ir.MDValue:
    """Return the alias scope of the function that is being compiled."""
    module = builder.module
    domain = module.add_metadata(["moireaug"])
    return module.add_metadata([module.add_metadata([builder.function.name, domain])])


def _row(array) -> bool:
    return isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"


def _address(context, builder, array_type, array, index_type, index):
    data = context.make_array(array_type)(context, builder, array).data
    index = context.cast(builder, index, index_type, types.intp)
    return builder.gep(data, [index], inbounds=True)


@intrinsic
def peek(typing, array, index):
    """Return array[index] of a contiguous one-dimensional array that no `poke` of the same function
    writes to.

    The index must be in range, and not negative.
    """
    if not _row(array):
        return None

    def generate(context, builder, signature, args):
        pointer = _address(context, builder, array, args[0], index, args[1])
        value = builder.load(pointer, typ=context.get_data_type(array.dtype))
        value.set_metadata("noalias", _scope(builder))
        return value

    return array.dtype(array, index), generate


@intrinsic
def poke(typing, array, index, value):
    """Set array[index] = value, of an array that no `peek` of the same function reads."""
    if not _row(array):
        return None

    def generate(context, builder, signature, args):
        pointer = _address(context, builder, array, args[0], index, args[1])
        store = builder.store(context.cast(builder, args[2], value, array.dtype), pointer)
        store.set_metadata("alias.scope", _scope(builder))
        return context.get_dummy_value()

    return types.none(array, index, value), generate


def _vector(lanes: int) -> ir.VectorType:
    return ir.VectorType(ir.FloatType(), lanes)


def _load(builder, pointer, lanes):
    """Load `lanes` float32 from `pointer`, aligned or not."""
    value = builder.load(builder.bitcast(pointer, _vector(lanes).as_pointer()), typ=_vector(lanes))
    value.align = 4
    return value


def _spread(builder, scalar, lanes):
    """Return a vector with one number in all lanes."""
    one = builder.insert_element(
        ir.Constant(_vector(1), ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0)
    )
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
    return builder.shuffle_vector(one, ir.Constant(_vector(1), ir.Undefined), zeros)


def _spread_lane(builder, vector, lane, lanes):
    """Return a vector with one lane of another in all lanes."""
    same = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [lane] * lanes)
    return builder.shuffle_vector(vector, ir.Constant(_vector(lanes), ir.Undefined), same)


def _lanes(builder, vector, first, count):
    """Return `count` of a vector's numbers from `first` on."""
    chosen = ir.Constant(ir.VectorType(ir.IntType(32), count), list(range(first, first + count)))
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), chosen)


def _fma(builder, a, b, c):
    kind = ir.FunctionType(a.type, [a.type] * 3)
    function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.fma.v{a.type.count}f32")
    return builder.call(function, [a, b, c])


def _total(builder, vector):
    """Return the sum of a vector's numbers, in any order."""
    kind = ir.FunctionType(ir.FloatType(), [ir.FloatType(), vector.type])
    function = cgutils.get_or_insert_function(
        builder.module, kind, f"llvm.vector.reduce.fadd.v{vector.type.count}f32"
    )
    return builder.call(
        function, [ir.Constant(ir.FloatType(), -0.0), vector], fastmath=("reassoc",)
    )


def _between(builder, a, b, share):
    return _fma(builder, share, builder.fsub(b, a), a)


def _floats(*arrays) -> bool:
    return all(_row(a) and a.dtype == types.float32 for a in arrays)


def _weights(builder, load, index, to_next, between, share, cells):
    """Return `cells` numbers of a table: `between` of the way from those at an index to those
    behind them, and `share` of the way to those `to_next` ahead."""
    # a phase's weights and the next one's lie side by side
    here, there = load(index, 2 * cells), load(builder.add(index, to_next), 2 * cells)
    both = _between(builder, here, there, _spread(builder, share, 2 * cells))
    phase, next_phase = _lanes(builder, both, 0, cells), _lanes(builder, both, cells, cells)
    return _between(builder, phase, next_phase, _spread(builder, between, cells))


def _loader(context, builder, kind, array):
    """Return a function that loads `lanes` numbers of an array from an index on."""

    def load(index, lanes):
        address = _address(context, builder, kind, array, types.intp, index)
        return _load(builder, address, lanes)

    return load


def _down_weights(cells: int):
    """Make an intrinsic that stores the weights of `cells` cells."""

    @intrinsic
    def down_weights(typing, out, start, table, to_next, place, between, share):
        """Fill out[start:] with `cells` numbers of a table, see `_weights`. Numbers float32,
        indices int32."""
        if not _floats(out, table):
            return None

        def generate(context, builder, signature, args):
            start_, to_next_, place_ = (
                context.cast(builder, args[i], types.int32, types.intp) for i in (1, 3, 4)
            )
            load = _loader(context, builder, table, args[2])
            found = _weights(builder, load, place_, to_next_, args[5], args[6], cells)
            target = _address(context, builder, out, args[0], types.intp, start_)
            store = builder.store(found, builder.bitcast(target, _vector(cells).as_pointer()))
            store.align = 4
            return context.get_dummy_value()

        whole, real = types.int32, types.float32
        return types.none(out, whole, table, whole, whole, real, real), generate

    return down_weights


def _weighted_cells(cells: int, rows: int):
    """Make an intrinsic that weighs the `rows` rows in the middle of `cells` x `cells` cells of a
    panel; those above and below weigh nothing."""
    skipped = (cells - rows) // 2

    @intrinsic
    def weighted_cells(
        typing, panel, at, stride, table, to_next, place, between, share, down, start
    ):
        """Return the sum of panel[at + j * stride + i] * across[i] * down[start + j] over
        i, j < cells, float32.

        across is `cells` numbers of the table, see `_weights`. Numbers float32, indices int32.
        """
        if not _floats(panel, table, down):
            return None

        def generate(context, builder, signature, args):
            at_, stride_, to_next_, place_, start_ = (
                context.cast(builder, args[i], types.int32, types.intp) for i in (1, 2, 4, 5, 9)
            )
            row = _loader(context, builder, panel, args[0])
            load = _loader(context, builder, table, args[3])
            across = _weights(builder, load, place_, to_next_, args[6], args[7], cells)
            weight = _loader(context, builder, down, args[8])(start_, cells)
            for _ in range(skipped):
                at_ = builder.add(at_, stride_)
            total = builder.fmul(_spread_lane(builder, weight, skipped, cells), row(at_, cells))
            for j in range(skipped + 1, skipped + rows):
                at_ = builder.add(at_, stride_)
                lane = _spread_lane(builder, weight, j, cells)
                total = _fma(builder, lane, row(at_, cells), total)
            return _total(builder, builder.fmul(total, across))

        whole, real = types.int32, types.float32
        indices = panel, whole, whole, table, whole, whole
        return real(*indices, real, real, down, whole), generate

    return weighted_cells


four_weights, eight_weights = _down_weights(4), _down_weights(8)
four_by_four, eight_by_six = _weighted_cells(4, 4), _weighted_cells(8, 6)
eight_by_eight = _weighted_cells(8, 8)


def _taps(lanes: int):
    """Make an intrinsic that sums rows for `lanes` pixels at once."""

    @intrinsic
    def taps(typing, out, start, coefficients, first, count, rows, offsets, base):
        """Do the same as `add_taps`, for the `lanes` pixels from `start` on."""
        if not _floats(out, coefficients, rows):
            return None

        def generate(context, builder, signature, args):
            start_, first_, count_, base_ = (
                context.cast(builder, args[i], signature.args[i], types.intp) for i in (1, 3, 4, 7)
            )

            def address(i, index):
                return _address(context, builder, signature.args[i], args[i], types.intp, index)

            target = address(0, start_)
            total = cgutils.alloca_once_value(builder, _load(builder, target, lanes))
            with cgutils.for_range(builder, count_, intp=count_.type) as tap:
                index = builder.add(first_, tap.index)
                offset = builder.load(
                    _address(context, builder, offsets, args[6], types.intp, index), typ=base_.type
                )
                row = _load(builder, address(5, builder.add(base_, offset)), lanes)
                weight = builder.load(address(2, index), typ=ir.FloatType())
                weight = _spread(builder, weight, lanes)
                builder.store(_fma(builder, weight, row, builder.load(total)), total)
            store = builder.store(
                builder.load(total), builder.bitcast(target, _vector(lanes).as_pointer())
            )
            store.align = 4
            return context.get_dummy_value()

        return types.none(out, start, coefficients, first, count, rows, offsets, base), generate

    return taps


_few, _many = _taps(LANES), _taps(4 * LANES)


@inner
def add_taps(out, start, lanes, coefficients, first, count, rows, offsets, base):
    """Add the sum over l < count of coefficients[first + l] * rows[base + offsets[first + l] + i]
    to out[start + i], for i < lanes, a multiple of LANES. Offsets are int64, the other arrays
    float32."""
    wide = lanes - lanes % (4 * LANES)
    for i in range(0, wide, 4 * LANES):
        _many(out, start + i, coefficients, first, count, rows, offsets, base + i)
    for i in range(wide, lanes, LANES):
        _few(out, start + i, coefficients, first, count, rows, offsets, base + i)


@inner
def add(out, row, factor):
    """Add factor * row to out, (n,) each."""
    for i in range(len(out)):
        poke(out, i, out[i] + factor * peek(row, i))
