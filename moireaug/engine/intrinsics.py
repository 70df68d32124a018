"""The LLVM code of the intrinsics of `vectors`: each `emit_` function writes one's body."""

from __future__ import annotations

from functools import partial

from llvmlite import ir
from numba import types
from numba.core import cgutils

INDEX = ir.IntType(64)


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


def emit_taps(lanes, sums, context, builder, signature, args):
    """Write what `vectors._taps` makes."""
    start, apart, first, each, count, base = _indices(
        context, builder, signature, args, (1, 2, 4, 5, 6, 9)
    )

    at = _pointers(context, builder, signature, args)
    targets = [at(0, place) for place in _steps(builder, start, apart, sums)]
    totals = [cgutils.alloca_once_value(builder, _load(builder, to, lanes)) for to in targets]
    with cgutils.for_range(builder, count, intp=count.type) as tap:
        index = builder.add(first, tap.index)
        offset = builder.load(at(8, index), typ=base.type)
        row = _load(builder, at(7, builder.add(base, offset)), lanes)
        for total, place in zip(totals, _steps(builder, index, each, sums), strict=True):
            weight = _spread(builder, builder.load(at(3, place), typ=ir.FloatType()), lanes)
            builder.store(_fma(builder, weight, row, builder.load(total)), total)
    for total, target in zip(totals, targets, strict=True):
        _store(builder, builder.load(total), target)
    return context.get_dummy_value()


def emit_down_weights(cells, pixels, context, builder, signature, args):
    """Write what `vectors._down_weights` makes."""
    to_next, first = _indices(context, builder, signature, args, (2, 6))
    at = _pointers(context, builder, signature, args)
    places = _whole_numbers(builder, at(3, first), pixels)
    between, share = _load(builder, at(4, first), pixels), _load(builder, at(5, first), pixels)
    found = _weights(builder, partial(at, 1), to_next, places, between, share, cells)
    start = builder.mul(first, ir.Constant(first.type, cells))
    _store(builder, found, at(0, start))
    return context.get_dummy_value()


def emit_weighted_cells(cells, rows, pixels, context, builder, signature, args):
    """Write what `vectors._weighted_cells` makes."""
    stride, to_next, first = _indices(context, builder, signature, args, (3, 5, 10))
    at = _pointers(context, builder, signature, args)
    places = _whole_numbers(builder, at(6, first), pixels)
    between, share = _load(builder, at(7, first), pixels), _load(builder, at(8, first), pixels)
    across = _weights(builder, partial(at, 4), to_next, places, between, share, cells)
    start = builder.mul(first, ir.Constant(first.type, cells))
    down = _load(builder, at(9, start), pixels * cells)
    bases, total = _whole_numbers(builder, at(2, first), pixels), None
    for j in range(cells):
        if (cells - rows) // 2 <= j < (cells + rows) // 2:
            row = _joined(builder, [_load(builder, at(1, base), cells) for base in bases])
            weight = _lanes(builder, down, [p * cells + j for p in _each(pixels, cells)])
            if total is None:
                total = builder.fmul(weight, row)
            else:
                total = _fma(builder, weight, row, total)
        bases = [builder.add(base, stride) for base in bases]
    sums = _totals(builder, builder.fmul(total, across), cells)
    _store(builder, sums, at(0, first))
    return context.get_dummy_value()


def _scope(builder: ir.IRBuilder) -> ir.MDValue:
    """Return the alias scope of the function that is being compiled."""
    module = builder.module
    domain = module.add_metadata(["moireaug"])
    return module.add_metadata([module.add_metadata([builder.function.name, domain])])


def _indices(context, builder, signature, args, places):
    """Return the arguments at some places as indices."""
    return [context.cast(builder, args[i], signature.args[i], types.intp) for i in places]


def _steps(builder, first, step, count):
    """Return `count` indices from the first on, a step apart."""
    found = [first]
    for _ in range(count - 1):
        found.append(builder.add(found[-1], step))
    return found


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


def _pointers(context, builder, signature, args):
    """Return a function that gives the address of an element: of which argument, and where."""

    def at(i, index):
        return _address(context, builder, signature.args[i], args[i], types.intp, index)

    return at


def _whole_numbers(builder, pointer, count):
    """Load `count` numbers, int32, from `pointer`, each as an index."""
    found = []
    for i in range(count):
        place = builder.gep(pointer, [ir.Constant(INDEX, i)], inbounds=True)
        found.append(builder.sext(builder.load(place, typ=ir.IntType(32)), INDEX))
    return found


def _spread(builder, scalar, lanes):
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


def _joined(builder, vectors):
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


def _totals(builder, vector, cells):
    """Return the sum of every `cells` numbers of a vector."""
    lanes, apart = vector.type.count, cells // 2
    while apart:
        other = _lanes(builder, vector, [i ^ apart for i in range(lanes)])
        vector, apart = builder.fadd(vector, other), apart // 2
    return _lanes(builder, vector, list(range(0, lanes, cells)))


def _between(builder, a, b, share):
    return _fma(builder, share, builder.fsub(b, a), a)


def _weights(builder, table, to_next, places, between, share, cells):
    """Return `cells` numbers of a table for each of some pixels: `between` of the way from those at
    its place to those behind them, and `share` of the way to those `to_next` ahead."""
    # a phase's weights and the next one's lie side by side
    ahead = [builder.add(place, to_next) for place in places]
    here = _joined(builder, [_load(builder, table(place), 2 * cells) for place in places])
    there = _joined(builder, [_load(builder, table(place), 2 * cells) for place in ahead])
    pixels = len(places)
    both = _between(builder, here, there, _lanes(builder, share, _each(pixels, 2 * cells)))
    firsts = [2 * cells * p + i for p in range(pixels) for i in range(cells)]
    phase, next_phase = (_lanes(builder, both, [i + k for i in firsts]) for k in (0, cells))
    return _between(builder, phase, next_phase, _lanes(builder, between, _each(pixels, cells)))
