"""Eight doubles as one value in compiled code: one instruction for eight arms.

numba leaves it to LLVM to find such instructions, which loops over small matrices defeat. Here
a row of an array (..., 8) is loaded into one vector register, calculated with by the usual
operators, and stored. Every lane gets the operations of a scalar program in their order, so that
an arm's numbers do not depend on its lane or on its neighbours.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import extending, types
from numba.core.datamodel import models

__all__ = ["LANES", "load", "pick", "splat", "store"]

LANES = 8
"""Arms that are worked on at once."""

_VECTOR = ir.VectorType(ir.DoubleType(), LANES)


class _Lanes(types.Type):
    """Type of eight doubles."""

    def __init__(self) -> None:
        super().__init__(name=f"float64x{LANES}")


_lanes = _Lanes()


@extending.register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)  # type: ignore[no-untyped-call]


def _row(context: Any, builder: Any, kind: Any, array: Any, row: Any) -> Any:
    """Pointer to a row of a contiguous array, counted in rows of eight."""
    data = context.make_array(kind)(context, builder, array).data
    first = builder.gep(data, [builder.mul(row, ir.Constant(row.type, LANES))])
    return builder.bitcast(first, _VECTOR.as_pointer())


def _instruction(code: Callable[..., Any]) -> Any:
    """Make a compiled function; numba itself passes the typing context, its first argument."""
    return extending.intrinsic(code)


@_instruction
def load(typing: Any, array: Any, row: Any) -> Any:
    """Load a row of a contiguous array (..., 8), rows counted through."""

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        value = builder.load(_row(context, builder, signature.args[0], *given))
        value.align = 8
        return value

    return _lanes(array, types.intp), code


@_instruction
def store(typing: Any, array: Any, row: Any, value: Any) -> Any:
    """Store into a row of a contiguous array (..., 8), rows counted through."""

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        stored = builder.store(given[2], _row(context, builder, signature.args[0], *given[:2]))
        stored.align = 8
        return context.get_dummy_value()

    return types.none(array, types.intp, value), code


@_instruction
def splat(typing: Any, number: Any) -> Any:
    """Eight times one number."""

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        vector = ir.Constant(_VECTOR, ir.Undefined)
        for lane in range(LANES):
            vector = builder.insert_element(vector, given[0], ir.Constant(ir.IntType(32), lane))
        return vector

    return _lanes(types.float64), code


@_instruction
def pick(typing: Any, a: Any, b: Any, below: Any, other: Any) -> Any:
    """Take ``below`` in the lanes where ``a < b``, else ``other``."""

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", given[0], given[1]), given[2], given[3])

    return _lanes(_lanes, _lanes, _lanes, _lanes), code


def _overload(symbol: Any, instruction: str) -> None:
    """Let an operator of two values be one instruction."""

    @_instruction
    def calculated(typing: Any, a: Any, b: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            return getattr(builder, instruction)(*given)

        return _lanes(_lanes, _lanes), code

    @extending.overload(symbol, strict=False)
    def implementation(a: Any, b: Any) -> Any:
        if isinstance(a, _Lanes) and isinstance(b, _Lanes):
            return lambda a, b: calculated(a, b)
        return None


for _symbol, _operation in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _overload(_symbol, _operation)
