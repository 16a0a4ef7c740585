"""Vector registers in compiled loops: eight numbers that are computed with at once.

A register array is a one-dimensional float64 array whose numbers 8 i to 8 i + 7 are the register i.
The functions below load some of its registers as a tuple, work on such tuples and store them; they
exist in compiled code only. Every lane goes through the same instructions, so that a number's bits
depend neither on its lane nor on the other lanes.

numba keeps machine code until the module that is compiled changes: after a change here, touch the
modules that use it.
"""

# mypy: disable-error-code="no-untyped-call"

from collections.abc import Callable
from inspect import signature
from typing import Any, cast

import numpy as np
from llvmlite import ir
from llvmlite.binding import get_host_cpu_features
from numba.core import cgutils, types
from numba.extending import intrinsic, models, register_model

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.compiling import compiled

LANES = 8
WIDE = get_host_cpu_features().get("avx512f", False)
"""True where the processor has 32 registers of `LANES` numbers. Others make two or more of each of
these, and have room for some at a time: more would go to memory and back."""
_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
Compiled = Callable[..., Any]


class _Register(types.Type):
    def __init__(self) -> None:
        super().__init__(name=f"register of {LANES} float64")


@register_model(_Register)
class _RegisterModel(models.PrimitiveModel):
    def __init__(self, manager: Any, of: _Register) -> None:
        super().__init__(manager, of, _VECTOR)


_REGISTER = _Register()


def _generated(function: Compiled) -> Compiled:
    """A function of compiled code: `function` gives its type and what generates its code."""
    return cast("Compiled", intrinsic(function))


def _operation(build: Compiled) -> Compiled:
    """A function of compiled code that makes as many registers as its first argument has.

    `build` generates them from tuples of registers.
    """

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        given = [cgutils.unpack_tuple(builder, argument) for argument in arguments]
        return cgutils.pack_array(builder, build(builder, *given))

    typed: dict[int, Compiled] = {
        1: lambda typing, a: (a(a), code),
        2: lambda typing, a, b: (a(a, b), code),
        3: lambda typing, a, b, c: (a(a, b, c), code),
    }
    return _generated(typed[len(signature(build).parameters) - 1])


@_operation
def less_product(builder: Any, tile: Any, column: Any, row: Any) -> Any:
    """tile[i, j] - column[i] * row[j], rounded once where the processor can."""
    of = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
    fused = cgutils.get_or_insert_function(builder.module, of, f"llvm.fmuladd.v{LANES}f64")
    products = [(builder.fneg(a), b) for a in column for b in row]
    return [builder.call(fused, [a, b, c]) for (a, b), c in zip(products, tile, strict=True)]


@_operation
def times(builder: Any, registers: Any, factor: Any) -> Any:
    """Each of `registers` times the one of `factor`."""
    return [builder.fmul(register, factor[0]) for register in registers]


@_operation
def plus(builder: Any, one: Any, other: Any) -> Any:
    """The sums of two tuples."""
    return [builder.fadd(a, b) for a, b in zip(one, other, strict=True)]


@_operation
def minus(builder: Any, one: Any, other: Any) -> Any:
    """The differences of two tuples."""
    return [builder.fsub(a, b) for a, b in zip(one, other, strict=True)]


@_operation
def reciprocal(builder: Any, registers: Any) -> Any:
    """1 / each of `registers`."""
    return [builder.fdiv(ir.Constant(_VECTOR, [1.0] * LANES), a) for a in registers]


@_operation
def transposed(builder: Any, registers: Any) -> Any:
    """Of as many registers as each has lanes, the first lanes, then the second lanes, and so on."""
    rows, block = list(registers), LANES // 2
    # Blocks beside the diagonal change places: of half the lanes, then of a quarter, ...
    while block:
        first = [(k & block) * LANES // block + (k & ~block) for k in range(LANES)]
        picked = [
            ir.Constant(ir.VectorType(ir.IntType(32), LANES), lanes)
            for lanes in (first, [k + block for k in first])
        ]
        for k in range(LANES):
            if not k & block:
                pair = rows[k], rows[k + block]
                rows[k], rows[k + block] = (builder.shuffle_vector(*pair, p) for p in picked)
        block //= 2
    return rows


@_generated
def spread(typing: Any, numbers: Any) -> Any:
    """Registers of which each has one of a tuple of numbers in every lane."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        registers = []
        for number in cgutils.unpack_tuple(builder, arguments[0]):
            register = ir.Constant(_VECTOR, ir.Undefined)
            for lane in range(LANES):
                register = builder.insert_element(register, number, ir.IntType(32)(lane))
            registers.append(register)
        return cgutils.pack_array(builder, registers)

    return types.UniTuple(_REGISTER, len(numbers))(numbers), code


@_generated
def total(typing: Any, register: Any) -> Any:
    """The sum of the lanes of one register."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        of = ir.FunctionType(ir.DoubleType(), [ir.DoubleType(), _VECTOR])
        name = f"llvm.vector.reduce.fadd.v{LANES}f64"
        summed = cgutils.get_or_insert_function(builder.module, of, name)
        (lanes,) = cgutils.unpack_tuple(builder, arguments[0])
        return builder.call(summed, [ir.DoubleType()(0.0), lanes], fastmath=("reassoc",))

    return types.float64(register), code


def _loader(count: int) -> Compiled:
    @_generated
    def load(typing: Any, array: Any, at: Any, step: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            places = _places(context, builder, array, arguments, count)
            return cgutils.pack_array(builder, [builder.load(p, align=8) for p in places])

        return types.UniTuple(_REGISTER, count)(array, types.int64, types.int64), code

    return load


load1, load2, load4, load16 = _loader(1), _loader(2), _loader(4), _loader(16)
"""load4(array, at, step): the four registers at, at + step, ... of a register array."""


@_generated
def store(typing: Any, array: Any, at: Any, step: Any, registers: Any) -> Any:
    """Put `registers` into a register array as its registers at, at + step, ..."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        given = cgutils.unpack_tuple(builder, arguments[3])
        places = _places(context, builder, array, arguments, len(given))
        for register, place in zip(given, places, strict=True):
            builder.store(register, place, align=8)
        return context.get_dummy_value()

    return types.void(array, types.int64, types.int64, registers), code


@_generated
def prefetch(typing: Any, array: Any, at: Any) -> Any:
    """Ask for register `at` of a register array to be in the second cache by and by."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number, byte = ir.IntType(32), ir.IntType(8).as_pointer()
        (place,) = _places(context, builder, array, (*arguments, ir.IntType(64)(1)), 1)
        of = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        ask = builder.module.declare_intrinsic("llvm.prefetch", [byte], of)
        # To read it; it is used again (2 of 3); data, not code.
        builder.call(ask, [builder.bitcast(place, byte), number(0), number(2), number(1)])
        return context.get_dummy_value()

    return types.void(array, types.int64), code


def _places(context: Any, builder: Any, array: Any, arguments: Any, count: int) -> list[Any]:
    """Addresses of registers at, at + step, ... of an array, the first three arguments."""
    value, at, step = arguments[:3]
    data = context.make_array(array)(context, builder, value).data
    places = []
    for k in range(count):
        register = builder.add(at, builder.mul(step, ir.Constant(step.type, k)))
        number = builder.mul(register, ir.Constant(at.type, LANES))
        places.append(builder.bitcast(builder.gep(data, [number]), _VECTOR.as_pointer()))
    return places


@compiled
def new_registers(count: int) -> Array:
    """A register array that begins at a line of the cache; its numbers are left as they are."""
    numbers = np.empty(LANES * (count + 1))
    first = -(numbers.ctypes.data // 8) % LANES
    return numbers[first : first + LANES * count]
