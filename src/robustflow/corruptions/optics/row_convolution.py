"""Convolve the rows of transformed images along y with kernels that differ from row to row.

The innermost loop is written in the compiler's own language, because all its sums stay in registers there: LANES
neighbouring rows are summed together, each in a chain of fused multiplications and additions with a fixed order. The
compiler splits vectors where registers are narrower, so the result does not depend on the processor.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ...core.compiled import code_tools, inner, intrinsic, njit

BLOCK = 64
"""Number of image rows transformed together."""

CHUNK = 32
"""Number of rows whose nodes are grouped alike."""

LANES = 16
"""Number of neighbouring rows that are summed together."""

GROUP = 4
"""Number of nodes whose kernels are blended in one chain."""

LINES = 4
"""Number of complex lines convolved together."""

_PLUS, _MINUS = np.float32(1.0), np.float32(-1.0)


class _Vectors:
    """Generate the instructions for vectors of LANES numbers in arrays and registers."""

    def __init__(self, builder: Any) -> None:
        ir, self.tools, _ = code_tools()
        self.builder, self.kind = builder, ir.VectorType(ir.FloatType(), LANES)
        self.zero, self.unset = ir.Constant(self.kind, None), ir.Constant(self.kind, ir.Undefined)
        self.start, self.lane = ir.IntType(64)(0), ir.IntType(32)(0)
        self.all_from_lane = ir.Constant(ir.VectorType(ir.IntType(32), LANES), None)
        name, kind = f"llvm.fma.v{LANES}f32", ir.FunctionType(self.kind, [self.kind] * 3)
        self.function = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)

    def index(self, *products: tuple[Any, Any]) -> Any:
        """Return the sum of the products of values of the code; second factors can also be numbers."""
        total = self.start
        for a, b in products:
            total = self.builder.add(total, self.builder.mul(a, a.type(b) if isinstance(b, int) else b))
        return total

    def at(self, data: Any, index: Any) -> Any:
        return self.builder.bitcast(self.builder.gep(data, [index]), self.kind.as_pointer())

    def load(self, data: Any, index: Any) -> Any:
        return self.builder.load(self.at(data, index), align=4)

    def repeat(self, data: Any, index: Any) -> Any:
        """Return a vector of copies of one number of an array."""
        value = self.builder.load(self.builder.gep(data, [index]))
        vector = self.builder.insert_element(self.unset, value, self.lane)
        return self.builder.shuffle_vector(vector, vector, self.all_from_lane)

    def registers(self, count: int) -> list[Any]:
        return [self.tools.alloca_once(self.builder, self.kind) for _ in range(count)]

    def clear(self, registers: list[Any]) -> None:
        for register in registers:
            self.builder.store(self.zero, register)

    def fma(self, a: Any, b: Any, c: Any) -> Any:
        """Return a * b + c, rounded once."""
        return self.builder.call(self.function, [a, b, c])


@intrinsic
def _convolve(_: Any, arrays: Any, starts: Any, sizes: Any) -> Any:
    """Convolve LINES complex lines with a kernel that is interpolated for each of LANES rows, and store the sums.

    `arrays` are the kernels, their weights, the groups, the lines and the results, which begin at `starts`.
    `sizes` are the number of groups and of lags, the last node, and the distances between nodes, between the weights
    of two nodes, between lines and between results.
    """

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        make = _Vectors(builder)
        nodes, weights, groups, lines, out = (
            builder.gep(
                context.make_array(kind)(context, builder, builder.extract_value(values[0], n)).data,
                [builder.extract_value(values[1], n)],
            )
            for n, kind in enumerate(signature.args[0])
        )
        count, lags, last, node, row, line, result = (builder.extract_value(values[2], n) for n in range(7))
        totals, blended = make.registers(3 * LINES), make.registers(3)
        make.clear(totals)
        with make.tools.for_range(builder, lags) as lag:
            make.clear(blended)
            with make.tools.for_range(builder, count) as group:
                u, v = make.zero, make.zero
                first = builder.load(builder.gep(groups, [group.index]))
                for n in range(GROUP):
                    number = builder.add(first, first.type(n))
                    inside = builder.select(builder.icmp_signed("<", number, last), number, last)
                    weight, place = (
                        make.load(weights, make.index((number, row))),
                        make.index((inside, node), (lag.index, 2)),
                    )
                    u = make.fma(weight, make.repeat(nodes, place), u)
                    v = make.fma(weight, make.repeat(nodes, builder.add(place, first.type(1))), v)
                for register, value in zip(blended, (u, builder.fadd(u, v), builder.fsub(v, u)), strict=True):
                    builder.store(builder.fadd(builder.load(register), value), register)
            kernel = [builder.load(register) for register in blended]
            for n, total in enumerate(totals):
                pixels = make.load(lines, make.index((line, n), (lag.index, 1)))
                builder.store(make.fma(kernel[n % 3], pixels, builder.load(total)), total)
        for n in range(LINES):
            a, b, c = (builder.load(total) for total in totals[3 * n : 3 * n + 3])
            builder.store(builder.fsub(a, b), make.at(out, make.index((result, 2 * n))), align=4)
            builder.store(builder.fadd(a, c), make.at(out, make.index((result, 2 * n + 1))), align=4)
        return context.get_dummy_value()

    return code_tools()[2].void(arrays, starts, sizes), generate


@inner
def _split(image: Any, channel: Any, t: Any, sign: Any, rows: Any, lines: Any) -> None:
    """Store x + y, y and x of complex pixels, upright and flipped."""
    for block in range(image.shape[1]):
        begin = block * BLOCK
        for i in range(np.minimum(BLOCK, rows - begin)):
            x, y = image[channel, block, t, 0, i], sign * image[channel, block, t, 1, i]
            up, down = np.uint64(begin + i), np.uint64(rows - 1 - begin - i)
            lines[0, 0, up] = lines[1, 0, down] = x + y
            lines[0, 1, up] = lines[1, 1, down] = y
            lines[0, 2, up] = lines[1, 2, down] = x


@inner
def _join(halves: Any, height: Any, sign: Any, channel: Any, t: Any, out: Any) -> None:
    """Add the upright and the flipped half, and store i times the conjugate of the sum, times `sign`."""
    for block in range(out.shape[1]):
        begin = block * BLOCK
        for i in range(np.minimum(BLOCK, height - begin)):
            up, down = np.uint64(begin + i), np.uint64(height - 1 - begin - i)
            out[channel, block, t, 0, i] = sign * (halves[0, 1, up] + halves[1, 1, down])
            out[channel, block, t, 1, i] = halves[0, 0, up] + halves[1, 0, down]


@njit(cache=True, nogil=True, error_model="numpy")
def convolve_rows(
    spectra: Any, image: Any, shape: Any, groups: Any, weights: Any, top: Any, work: Any, out: Any
) -> None:
    """Convolve an image along y; in the lower half, the kernel for each row is interpolated between the nearest
    nodes, and the upper half is the lower half of the flipped image.

    `groups` are, for LANES rows each, the number of groups with non-zero weights and their first nodes. `weights`
    are those of each node and row from `top`, followed by GROUP rows of zeros. `work` are the arrays of `work_arrays`.
    """
    (rows, height), (lines, halves) = shape, work
    length, lags, last = image.shape[2], spectra.shape[3], spectra.shape[0] - 1
    node = spectra.shape[1] * spectra.shape[2] * lags * 2
    for channel in range(3):
        for k in range(length // 2 + 1):
            both = 2 if 0 < 2 * k < length else 1
            for other in range(both):
                t, sign = (length - k, _MINUS) if other else (k, _PLUS)
                _split(image, channel, t, sign, rows, lines[other])
            kernel = (channel * (length // 2 + 1) + k) * lags * 2
            for n in range(len(groups)):
                begin = top + n * LANES
                starts = kernel, n * LANES, n * groups.shape[1] + 1, begin, begin
                sizes = groups[n, 0], lags, last, node, weights.shape[1], lines.shape[3], halves.shape[3]
                _convolve((spectra, weights, groups, lines, halves), starts, sizes)
            for other in range(both):
                t, sign = (length - k, _MINUS) if other else (k, _PLUS)
                _join(halves[other], height, sign, channel, t, out)


def work_arrays(rows: int, top: int, lanes: int) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return the lines k and T - k of an image with `rows` rows, and of the convolved halves from row `top`.

    A compiled function that created them would take longer to compile. The first `top` rows of the halves stay zero.
    """
    lines = np.zeros((2, 2, 3, rows + LANES), np.float32)  # (k, T - k) x (upright, flipped) x (x + y, y, x)
    return lines, np.zeros((2, 2, 2, top + lanes), np.float32)  # (k, T - k) x (upright, flipped) x (real, imaginary)
