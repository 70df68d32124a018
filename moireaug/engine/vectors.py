"""Loads and stores that are known not to overlap, so that LLVM vectorises a loop; and sums of rows in vectors."""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from moireaug.engine.record import LANES


def _scope(builder: ir.IRBuilder) -> ir.MDValue:
    """Return the scope of the function that is being compiled."""
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
    """Return array[index] of a contiguous one-dimensional array that no `poke` of the same function writes to.

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


def _load(builder, pointer):
    value = builder.load(pointer, typ=ir.VectorType(ir.FloatType(), LANES))
    value.align = 4
    return value


def _spread(builder, scalar):
    one = ir.VectorType(ir.FloatType(), 1)
    many = ir.VectorType(ir.FloatType(), LANES)
    single = builder.insert_element(ir.Constant(one, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    value = builder.shuffle_vector(single, ir.Constant(one, ir.Undefined), zeros)
    assert value.type == many
    return value


def _fma(builder, a, b, c):
    kind = ir.FunctionType(a.type, [a.type] * 3)
    function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.fma.v{LANES}f32")
    return builder.call(function, [a, b, c])


def _sums(context, builder, kinds, args, firsts, count, coefficients, rows, offset_of):
    """Emit, for each of `firsts`, the sum over l < count of coefficients[first + l] * rows[offset_of(l) + i]."""
    whole = count.type
    one, zero = ir.Constant(whole, 1), ir.Constant(ir.VectorType(ir.FloatType(), LANES), [0.0] * LANES)
    # two sums each, so that one multiplication need not wait for the last
    sums = [[cgutils.alloca_once_value(builder, zero) for _ in range(2)] for _ in firsts]

    def address(i, index):
        return _address(context, builder, kinds[i], args[i], types.intp, index)

    def add(index, turn):
        start = address(rows, offset_of(index))
        row = _load(builder, builder.bitcast(start, ir.VectorType(ir.FloatType(), LANES).as_pointer()))
        for first, pair in zip(firsts, sums, strict=True):
            coefficient = builder.load(address(coefficients, builder.add(first, index)), typ=ir.FloatType())
            total = _fma(builder, _spread(builder, coefficient), row, builder.load(pair[turn]))
            builder.store(total, pair[turn])

    with cgutils.for_range(builder, builder.lshr(count, one), intp=whole) as pair:
        index = builder.shl(pair.index, one)
        add(index, 0)
        add(builder.add(index, one), 1)
    with builder.if_then(builder.trunc(count, ir.IntType(1))):
        add(builder.sub(count, one), 0)
    return [builder.fadd(builder.load(a), builder.load(b)) for a, b in sums]


def _numbers(context, builder, signature, args):
    """Return the arguments, the numbers among them as the machine's integers."""
    return [
        a if isinstance(kind, types.Array) else context.cast(builder, a, kind, types.intp)
        for a, kind in zip(args, signature.args, strict=True)
    ]


def _floats(*arrays) -> bool:
    return all(_row(a) and a.dtype == types.float32 for a in arrays)


def _vector(context, builder, kind, array, index):
    pointer = _address(context, builder, kind, array, types.intp, index)
    return builder.bitcast(pointer, ir.VectorType(ir.FloatType(), LANES).as_pointer())


def _store(builder, value, pointer):
    builder.store(value, pointer).align = 4


@intrinsic
def add_taps(typing, out, start, coefficients, first, count, rows, offsets, base):
    """Add the sum over l < count of coefficients[first + l] * rows[base + offsets[first + l] + i] to out[start + i],
    for the LANES pixels i. Offsets are int64, all else float32."""
    if not _floats(out, coefficients, rows):
        return None

    def generate(context, builder, signature, args):
        out_, start_, _, first_, count_, _, offsets_, base_ = _numbers(context, builder, signature, args)

        def offset_of(index):
            pointer = _address(context, builder, offsets, offsets_, types.intp, builder.add(first_, index))
            return builder.add(base_, builder.load(pointer, typ=base_.type))

        (total,) = _sums(context, builder, signature.args, args, [first_], count_, 2, 5, offset_of)
        target = _vector(context, builder, out, out_, start_)
        _store(builder, builder.fadd(_load(builder, target), total), target)
        return context.get_dummy_value()

    return types.none(out, start, coefficients, first, count, rows, offsets, base), generate


@intrinsic
def add_waves(typing, out, start, other, factor, place, coefficients, first, second, count, rows, base, stride):
    """Add factor[place + i] * sum over l < count of coefficients[first + l] * rows[base + l * stride + i] to
    out[start + i], and the same with coefficients from `second` on to out[other + i], for the LANES pixels i."""
    if not _floats(out, factor, coefficients, rows):
        return None

    def generate(context, builder, signature, args):
        out_, start_, other_, factor_, place_, _, first_, second_, count_, _, base_, stride_ = _numbers(
            context, builder, signature, args
        )

        def offset_of(index):
            return builder.add(base_, builder.mul(index, stride_))

        sums = _sums(context, builder, signature.args, args, [first_, second_], count_, 5, 9, offset_of)
        weight = _load(builder, _vector(context, builder, factor, factor_, place_))
        for at, total in zip((start_, other_), sums, strict=True):
            target = _vector(context, builder, out, out_, at)
            _store(builder, _fma(builder, weight, total, _load(builder, target)), target)
        return context.get_dummy_value()

    return types.none(
        *(out, start, other, factor, place, coefficients, first, second, count, rows, base, stride)
    ), generate
