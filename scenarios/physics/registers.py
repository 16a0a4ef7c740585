"""Vector registers in compiled loops: the same number of eight samples, computed with at once.

A register array is a one-dimensional float64 array whose numbers 8 i to 8 i + 7 are the register i:
one number of each of eight samples. The functions below load some of its registers as a tuple, work
on such tuples and store them; they exist in compiled code only. No sample's number ever meets that
of another, and all eight go through the same instructions.
"""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.extending import intrinsic, models, register_model

LANES = 8
_VECTOR = ir.VectorType(ir.DoubleType(), LANES)


class _Register(types.Type):  # type: ignore[misc]
    def __init__(self) -> None:
        super().__init__(name=f"register of {LANES} float64")


@register_model(_Register)
class _RegisterModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, of: _Register) -> None:
        super().__init__(manager, of, _VECTOR)


_REGISTER = _Register()


def _place(context: Any, builder: Any, array: Any, value: Any, at: Any) -> Any:
    """The address of register `at` of a register array."""
    data = context.make_array(array)(context, builder, value).data
    number = builder.mul(at, ir.Constant(at.type, LANES))
    return builder.bitcast(builder.gep(data, [number]), _VECTOR.as_pointer())


def _loader(count: int) -> Callable[..., Any]:
    @intrinsic  # type: ignore[untyped-decorator]
    def load(typing: Any, array: Any, at: Any, step: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            value, first, stride = arguments
            registers = []
            for k in range(count):
                number = builder.add(first, builder.mul(stride, ir.Constant(stride.type, k)))
                place = _place(context, builder, array, value, number)
                registers.append(builder.load(place, align=8))
            return cgutils.pack_array(builder, registers)

        return types.UniTuple(_REGISTER, count)(array, types.int64, types.int64), code

    return load  # type: ignore[no-any-return]


load1, load4, load16 = _loader(1), _loader(4), _loader(16)
"""load4(array, at, step): the four registers at, at + step, ... of a register array."""


@intrinsic  # type: ignore[untyped-decorator]
def store(typing: Any, array: Any, at: Any, registers: Any) -> Any:
    """Put `registers` into a register array, from register `at` on."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        value, first, given = arguments
        for k, register in enumerate(cgutils.unpack_tuple(builder, given)):
            number = builder.add(first, ir.Constant(first.type, k))
            builder.store(register, _place(context, builder, array, value, number), align=8)
        return context.get_dummy_value()

    return types.void(array, types.int64, registers), code


@intrinsic  # type: ignore[untyped-decorator]
def less_product(typing: Any, tile: Any, column: Any, row: Any) -> Any:
    """tile[i, j] - column[i] * row[j], each rounded once where the processor can (FMA)."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        entries, left, right = (cgutils.unpack_tuple(builder, a) for a in arguments)
        pairs = [(builder.fneg(a), b) for a in left for b in right]
        of = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
        name = f"llvm.fmuladd.v{LANES}f64"
        fma = cgutils.get_or_insert_function(builder.module, of, name)
        return cgutils.pack_array(
            builder,
            [builder.call(fma, [a, b, c]) for (a, b), c in zip(pairs, entries, strict=True)],
        )

    return tile(tile, column, row), code


@intrinsic  # type: ignore[untyped-decorator]
def times(typing: Any, registers: Any, factor: Any) -> Any:
    """Each of `registers` times the one register of `factor`."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        given, (by,) = (cgutils.unpack_tuple(builder, a) for a in arguments)
        return cgutils.pack_array(builder, [builder.fmul(a, by) for a in given])

    return registers(registers, factor), code


@intrinsic  # type: ignore[untyped-decorator]
def plus(typing: Any, registers: Any, others: Any) -> Any:
    """The sums of two tuples of registers."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pairs = zip(*(cgutils.unpack_tuple(builder, a) for a in arguments), strict=True)
        return cgutils.pack_array(builder, [builder.fadd(a, b) for a, b in pairs])

    return registers(registers, others), code


@intrinsic  # type: ignore[untyped-decorator]
def reciprocal(typing: Any, registers: Any) -> Any:
    """1 / each of `registers`."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        one = ir.Constant(_VECTOR, [1.0] * LANES)
        given = cgutils.unpack_tuple(builder, arguments[0])
        return cgutils.pack_array(builder, [builder.fdiv(one, a) for a in given])

    return registers(registers), code
