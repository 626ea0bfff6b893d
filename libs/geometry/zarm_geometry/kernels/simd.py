"""A vector of 16 float32 for kernels: one value for each of 16 configurations that are checked together.

LLVM compiles each operation to the widest instructions of the processor. With a loop over 16 array elements this would
depend on the loop vectoriser, which gives up easily.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, cast

from llvmlite import ir
from numba import types
from numba.extending import intrinsic as numba_intrinsic
from numba.extending import lower_builtin, models, register_model, type_callable

LANES = 16

intrinsic = cast(Callable[[Callable[..., Any]], Any], numba_intrinsic)

Lanes = Any
"""16 float32; exists only inside kernels."""
Mask = Any
"""One bit per lane."""

_FAST = ("nnan", "ninf", "nsz", "contract")
_FLOATS = ir.VectorType(ir.FloatType(), LANES)


class LanesType(types.Type):
    """Numba's type of `Lanes`."""

    def __init__(self) -> None:
        super().__init__(name="Lanes")


lanes = LanesType()


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, fe_type: Any) -> None:
        super().__init__(manager, fe_type, _FLOATS)  # type: ignore[no-untyped-call]


def _splat(builder: Any, value: Any) -> Any:
    vector = builder.insert_element(ir.Constant(_FLOATS, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    order = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(vector, ir.Constant(_FLOATS, ir.Undefined), order)


def _binary(function: Callable[..., Any], instruction: str) -> None:
    """Define `function` for two Lanes, and for Lanes and a number in either order."""

    @type_callable(function)
    def signature_for(context: Any) -> Any:
        def signature(a: Any, b: Any) -> Any:
            if lanes in (a, b) and all(isinstance(x, LanesType | types.Number) for x in (a, b)):
                return lanes(*(x if x is lanes else types.float32 for x in (a, b)))
            return None

        return signature

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        a, b = (x if t is lanes else _splat(builder, x) for x, t in zip(args, sig.args, strict=True))
        return getattr(builder, instruction)(a, b, flags=_FAST)

    for a, b in ((lanes, lanes), (lanes, types.float32), (types.float32, lanes)):
        lower_builtin(function, a, b)(lower)


_binary(operator.add, "fadd")
_binary(operator.sub, "fsub")
_binary(operator.mul, "fmul")
_binary(operator.truediv, "fdiv")


def _llvm(name: str, arity: int) -> Any:
    """An LLVM intrinsic over Lanes."""

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        signature = ir.FunctionType(_FLOATS, [_FLOATS] * arity)
        function = builder.module.declare_intrinsic(f"llvm.{name}.v{LANES}f32", fnty=signature)
        return builder.call(function, args, fastmath=_FAST)

    return build


@intrinsic
def larger(typing: Any, a: Any, b: Any) -> Any:
    """The larger of two values, lane by lane."""
    return lanes(lanes, lanes), _llvm("maxnum", 2)


@intrinsic
def smaller(typing: Any, a: Any, b: Any) -> Any:
    """The smaller of two values, lane by lane."""
    return lanes(lanes, lanes), _llvm("minnum", 2)


@intrinsic
def magnitude(typing: Any, a: Any) -> Any:
    """Absolute value."""
    return lanes(lanes), _llvm("fabs", 1)


@intrinsic
def root(typing: Any, a: Any) -> Any:
    """Square root."""
    return lanes(lanes), _llvm("sqrt", 1)


@intrinsic
def nearest(typing: Any, a: Any) -> Any:
    """The nearest integer."""
    return lanes(lanes), _llvm("rint", 1)


@intrinsic
def splat(typing: Any, value: Any) -> Any:
    """The same number in all lanes."""
    return lanes(types.float32), lambda context, builder, sig, args: _splat(builder, args[0])


@intrinsic
def below(typing: Any, a: Any, b: Any) -> Any:
    """Mask of the lanes in which `a` < `b`."""

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        mask = builder.fcmp_ordered("<", args[0], args[1], flags=_FAST)
        return builder.zext(builder.bitcast(mask, ir.IntType(LANES)), ir.IntType(32))

    return types.uint32(lanes, lanes), build


@intrinsic
def where_positive(typing: Any, a: Any, value: Any) -> Any:
    """`value` in the lanes in which `a` > 0, and 0 in the others."""

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        zero = ir.Constant(_FLOATS, [0.0] * LANES)
        return builder.select(builder.fcmp_ordered(">", args[0], zero, flags=_FAST), args[1], zero)

    return lanes(lanes, lanes), build


@intrinsic
def without(typing: Any, mask: Any, a: Any) -> Any:
    """0 in the lanes of `mask`, and `a` in the others."""

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = builder.trunc(args[0], ir.IntType(LANES))
        chosen = builder.bitcast(bits, ir.VectorType(ir.IntType(1), LANES))
        return builder.select(chosen, ir.Constant(_FLOATS, [0.0] * LANES), args[1])

    return lanes(types.uint32, lanes), build


def _pointer(builder: Any, args: Any) -> Any:
    return builder.bitcast(builder.gep(args[0], [args[1]]), _FLOATS.as_pointer())


@intrinsic
def load(typing: Any, memory: Any, index: Any) -> Any:
    """Read 16 values, starting at `memory[index]`; `memory` points to float32."""

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.load(_pointer(builder, args), align=4)

    return lanes(types.CPointer(types.float32), types.intp), build


@intrinsic
def store(typing: Any, memory: Any, index: Any, value: Any) -> Any:
    """Write 16 values, starting at `memory[index]`; `memory` points to float32."""

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        builder.store(args[2], _pointer(builder, args), align=4)
        return context.get_dummy_value()

    return types.void(types.CPointer(types.float32), types.intp, lanes), build


@intrinsic
def pointer(typing: Any, array: Any) -> Any:
    """A pointer to the first element of an array. Whoever uses it must keep the array alive: numba frees an array after its last
    use by name, so only arrays that a function was given may be pointed to.

    Numba updates an array's reference count whenever it is passed on or taken out of a tuple, which costs more than the
    arithmetic in inner loops; a pointer costs nothing.
    """

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return context.make_array(sig.args[0])(context, builder, args[0]).data

    return types.CPointer(array.dtype)(array), build


@intrinsic
def lowest_bit(typing: Any, bits: Any) -> Any:
    """The index of the lowest bit that is set in a uint64 other than 0."""

    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.intp(types.uint64), build
