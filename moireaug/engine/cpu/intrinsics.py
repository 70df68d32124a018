"""The LLVM code of the intrinsics of `vectors`: each `emit_` function writes one's body.

Plain loops in their place take about as many times as long, on 16 pictures of 224 px and one thread
with AVX-512:

- `emit_content`: 1.13 to expose a frontal full reading, 1.2 a turned one
- `emit_tap_weights`: 1.06 and 1.17
- `emit_peek` and `emit_poke` without their alias scopes: 1.05 to develop, and 1.00 to expose
"""

from __future__ import annotations

from functools import partial

from llvmlite import ir
from numba import types
from numba.core import cgutils

INDEX_TYPE = ir.IntType(64)


def emit_peek(context, builder, signature, args):
    """Write `vectors.peek`."""
    array, index = signature.args
    pointer = _address(context, builder, array, args[0], index, args[1])
    value = builder.load(pointer, typ=context.get_data_type(array.dtype))
    value.set_metadata("noalias", _scope(builder))
    return value


def emit_poke(context, builder, signature, args):
    """Write `vectors.poke`."""
    array, index, value = signature.args
    pointer = _address(context, builder, array, args[0], index, args[1])
    store = builder.store(context.cast(builder, args[2], value, array.dtype), pointer)
    store.set_metadata("alias.scope", _scope(builder))
    return context.get_dummy_value()


def emit_tap_weights(taps, pixels, context, builder, signature, args):
    """Write what `vectors._vector_of_weights` makes."""
    (first,) = _indices(context, builder, signature, args, (2,))
    weights = _tap_weights(context, builder, signature.args[1], args[1], first, (taps, pixels))
    start = builder.mul(first, ir.Constant(first.type, taps))
    _store(builder, weights, _pointers(context, builder, signature.args, args)(0, start))
    return context.get_dummy_value()


def emit_content(taps, rows, pixels, context, builder, signature, args):
    """Write what `vectors._vector_of_content` makes."""
    stride, first = _indices(context, builder, signature, args, (3, 6))
    at = _pointers(context, builder, signature.args, args)
    across = _tap_weights(context, builder, signature.args[4], args[4], first, (taps, pixels))
    start = builder.mul(first, ir.Constant(first.type, taps))
    down = _load(builder, at(5, start), pixels * taps)
    bases, total = _whole_numbers(builder, at(2, first), pixels), None
    for j in range(taps):
        if (taps - rows) // 2 <= j < (taps + rows) // 2:
            row = _concatenated(builder, [_load(builder, at(1, base), taps) for base in bases])
            weight = _lanes(builder, down, [p * taps + j for p in _each(pixels, taps)])
            if total is None:
                total = builder.fmul(weight, row)
            else:
                total = _fma(builder, weight, row, total)
        bases = [builder.add(base, stride) for base in bases]
    sums = _totals(builder, builder.fmul(total, across), taps)
    _store(builder, sums, at(0, first))
    return context.get_dummy_value()


def emit_content_back(taps, rows, context, builder, signature, args):
    """Write what `vectors._content_back_of` makes for one pixel."""
    stride, pixel = _indices(context, builder, signature, args, (2, 6))
    at = _pointers(context, builder, signature.args, args)
    start = builder.mul(pixel, ir.Constant(pixel.type, taps))
    across = _load(builder, at(3, start), taps)
    grad = builder.load(at(5, pixel), typ=ir.FloatType())
    (base,) = _whole_numbers(builder, at(1, pixel), 1)
    for j in range(taps):
        if (taps - rows) // 2 <= j < (taps + rows) // 2:
            place = builder.add(start, ir.Constant(start.type, j))
            weight = builder.fmul(grad, builder.load(at(4, place), typ=ir.FloatType()))
            row, weight = _load(builder, at(0, base), taps), _broadcast(builder, weight, taps)
            _store(builder, _fma(builder, weight, across, row), at(0, base))
        base = builder.add(base, stride)
    return context.get_dummy_value()


def _scope(builder: ir.IRBuilder) -> ir.MDValue:
    """Return the alias scope of the function that is being compiled."""
    module = builder.module
    domain = module.add_metadata(["moireaug"])
    return module.add_metadata([module.add_metadata([builder.function.name, domain])])


def _indices(context, builder, signature, args, places):
    """Return the arguments at some places as indices."""
    return [context.cast(builder, args[i], signature.args[i], types.intp) for i in places]


def _address(context, builder, array_type, array, index_type, index):
    data = context.make_array(array_type)(context, builder, array).data
    index = context.cast(builder, index, index_type, types.intp)
    return builder.gep(data, [index], inbounds=True)


def _vector(lanes: int) -> ir.VectorType:
    return ir.VectorType(ir.FloatType(), lanes)


def _load(builder, pointer, lanes):
    """Load `lanes` float32 from `pointer`, aligned or not."""
    value = builder.load(builder.bitcast(pointer, _vector(lanes).as_pointer()), typ=_vector(lanes))
    value.align = 4
    return value


def _store(builder, vector, pointer):
    """Store a vector at `pointer`, aligned or not."""
    store = builder.store(vector, builder.bitcast(pointer, vector.type.as_pointer()))
    store.align = 4


def _pointers(context, builder, array_types, arrays):
    """Return a function that gives the address of an element: of which array, and where."""

    def at(i, index):
        return _address(context, builder, array_types[i], arrays[i], types.intp, index)

    return at


def _whole_numbers(builder, pointer, count):
    """Load `count` numbers, int32, from `pointer`, each as an index."""
    numbers = []
    for i in range(count):
        place = builder.gep(pointer, [ir.Constant(INDEX_TYPE, i)], inbounds=True)
        numbers.append(builder.sext(builder.load(place, typ=ir.IntType(32)), INDEX_TYPE))
    return numbers


def _broadcast(builder, scalar, lanes):
    """Return a vector with one number in all lanes."""
    one = builder.insert_element(
        ir.Constant(_vector(1), ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0)
    )
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
    return builder.shuffle_vector(one, ir.Constant(_vector(1), ir.Undefined), zeros)


def _lanes(builder, vector, lanes):
    """Return some lanes of a vector, as a vector."""
    chosen = ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), lanes)
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), chosen)


def _each(count, times):
    """Return 0 to `count` - 1, each several times in succession."""
    return [i for i in range(count) for _ in range(times)]


def _concatenated(builder, vectors):
    """Return vectors as one; their number is a power of two."""
    while len(vectors) > 1:
        lanes = 2 * vectors[0].type.count
        order = ir.Constant(ir.VectorType(ir.IntType(32), lanes), list(range(lanes)))
        pairs = zip(vectors[::2], vectors[1::2], strict=True)
        vectors = [builder.shuffle_vector(a, b, order) for a, b in pairs]
    return vectors[0]


def _fma(builder, a, b, c):
    kind = ir.FunctionType(a.type, [a.type] * 3)
    function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.fma.v{a.type.count}f32")
    return builder.call(function, [a, b, c])


def _totals(builder, vector, group):
    """Return the sum of each `group` of neighbouring numbers of a vector."""
    lanes, apart = vector.type.count, group // 2
    while apart:
        other = _lanes(builder, vector, [i ^ apart for i in range(lanes)])
        vector, apart = builder.fadd(vector, other), apart // 2
    return _lanes(builder, vector, list(range(0, lanes, group)))


def _between(builder, a, b, share):
    return _fma(builder, share, builder.fsub(b, a), a)


def _tap_weights(context, builder, record_type, record, first, counts):
    """Return the tap weights of some pixels, as a vector.

    Args:
        record: a `records.TapWeights`. first: the first of the pixels.
        counts: taps per pixel, and pixels.
    """
    taps, pixels = counts
    fields = [builder.extract_value(record, i) for i in range(len(record_type.types))]
    at = _pointers(context, builder, record_type.types, fields)
    table, to_next = partial(at, 0), context.cast(builder, fields[1], record_type[1], types.intp)
    places = _whole_numbers(builder, at(2, first), pixels)
    phase_share, node_share = (_load(builder, at(i, first), pixels) for i in (3, 4))
    ahead = [builder.add(place, to_next) for place in places]
    # a phase's weights and the next one's lie side by side
    here = _concatenated(builder, [_load(builder, table(place), 2 * taps) for place in places])
    there = _concatenated(builder, [_load(builder, table(place), 2 * taps) for place in ahead])
    both = _between(builder, here, there, _lanes(builder, node_share, _each(pixels, 2 * taps)))
    firsts = [2 * taps * p + i for p in range(pixels) for i in range(taps)]
    phase, next_phase = (_lanes(builder, both, [i + k for i in firsts]) for k in (0, taps))
    return _between(builder, phase, next_phase, _lanes(builder, phase_share, _each(pixels, taps)))
