"""The LLVM code of the intrinsics of `vectors`: each `emit_` function writes one's body."""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils


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
    """Write `vectors.add_taps` for `lanes` pixels of as many sums."""
    start, apart, first, each, count, base = _indices(
        context, builder, signature, args, (1, 2, 4, 5, 6, 9)
    )

    def at(i, index):
        return _address(context, builder, signature.args[i], args[i], types.intp, index)

    targets = [at(0, place) for place in _steps(builder, start, apart, sums)]
    totals = [cgutils.alloca_once_value(builder, _load(builder, at, lanes)) for at in targets]
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


def emit_down_weights(cells, context, builder, signature, args):
    """Write `vectors.four_weights` for any number of cells."""
    start, to_next, place = _indices(context, builder, signature, args, (1, 3, 4))
    load = _loader(context, builder, signature.args[2], args[2])
    found = _weights(builder, load, place, to_next, args[5], args[6], cells)
    target = _address(context, builder, signature.args[0], args[0], types.intp, start)
    _store(builder, found, target)
    return context.get_dummy_value()


def emit_weighted_cells(cells, rows, context, builder, signature, args):
    """Write `vectors.four_by_four` for any number of cells, of whose rows those in the middle
    count."""
    at, stride, to_next, place, start = _indices(context, builder, signature, args, (1, 2, 4, 5, 9))
    panel, table, down = (_loader(context, builder, signature.args[i], args[i]) for i in (0, 3, 8))
    across = _weights(builder, table, place, to_next, args[6], args[7], cells)
    weight = down(start, cells)
    skipped = (cells - rows) // 2
    for _ in range(skipped):
        at = builder.add(at, stride)
    total = builder.fmul(_spread_lane(builder, weight, skipped, cells), panel(at, cells))
    for j in range(skipped + 1, skipped + rows):
        at = builder.add(at, stride)
        total = _fma(builder, _spread_lane(builder, weight, j, cells), panel(at, cells), total)
    return _total(builder, builder.fmul(total, across))


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


def _loader(context, builder, kind, array):
    """Return a function that loads `lanes` numbers of an array from an index on."""

    def load(index, lanes):
        address = _address(context, builder, kind, array, types.intp, index)
        return _load(builder, address, lanes)

    return load


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


def _weights(builder, load, index, to_next, between, share, cells):
    """Return `cells` numbers of a table: `between` of the way from those at an index to those
    behind them, and `share` of the way to those `to_next` ahead."""
    # a phase's weights and the next one's lie side by side
    here, there = load(index, 2 * cells), load(builder.add(index, to_next), 2 * cells)
    both = _between(builder, here, there, _spread(builder, share, 2 * cells))
    phase, next_phase = _lanes(builder, both, 0, cells), _lanes(builder, both, cells, cells)
    return _between(builder, phase, next_phase, _spread(builder, between, cells))
