"""Solving the forward problem for eight samples at a time, one in each lane of a vector register.

The elimination is that of `elimination`, ordered for arithmetic: a front is cut into tiles of 4 x 4
unknowns, and a tile takes all pivots before it in one go, in registers. The bits of a sample depend
neither on its lane nor on the samples in the others, but for the last few they differ from those of
`elimination`, which takes the same sums in another order.

All is kept in register arrays (see `registers`). Of the tiles of a front, block row after block
row, only those of the upper triangle exist; each is 16 registers, row after row.
"""

import numpy as np

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.compiling import compiled
from eitbench.scenarios.physics.dissection import TILE, Dissection, tile_place
from eitbench.scenarios.physics.elimination import _invert
from eitbench.scenarios.physics.registers import (
    LANES, less_product, load1, load4, load16, plus, reciprocal, store, times,
)  # fmt: skip

_tile_place = compiled(tile_place)


@compiled
def _registers(count: int) -> Array:
    """A register array of `count` registers of 0 that begins at a line of the cache."""
    numbers = np.zeros(LANES * (count + 1))
    first = -(numbers.ctypes.data // 8) % LANES
    return numbers[first : first + LANES * count]


@compiled
def _eliminate(
    front: Array, size: int, eliminated: int, upper: Array, inverses: Array, factors: Array
) -> None:
    """Eliminate the first unknowns of a front in place; what is left of it are its other tiles.

    `upper` receives the rows u of the upper triangle, four columns after four, with their pivots'
    inverses in `inverses`; `factors` is room for 4 registers a pivot.
    """
    blocks = (size + TILE - 1) // TILE
    tiles = 0
    for block in range(blocks):
        first = block * TILE
        before = min(first, eliminated)
        for k in range(before):
            row = load4(upper, (block * eliminated + k) * TILE, 1)
            store(factors, k * TILE, times(row, load1(inverses, k, 1)))
        if before > 0:
            for column in range(block, blocks):
                at, other = (tiles + column - block) * 16, column * eliminated * TILE
                tile = load16(front, at, 1)
                for k in range(before):
                    tile = less_product(
                        tile, load4(factors, k * TILE, 1), load4(upper, other + k * TILE, 1)
                    )
                store(front, at, tile)
        if first < eliminated:
            _pivot_rows(
                front[tiles * 16 * LANES :], first, min(TILE, eliminated - first), eliminated,
                blocks - block, upper[block * eliminated * TILE * LANES :], inverses, factors,
            )  # fmt: skip
        tiles += blocks - block


@compiled
def _pivot_rows(
    tiles: Array, first: int, count: int, eliminated: int, blocks: int, upper: Array,
    inverses: Array, factors: Array,
) -> None:  # fmt: skip
    """Eliminate `count` unknowns with each other, in the four rows of their `tiles`."""
    for k in range(count):
        row, inverse = load4(tiles, k * TILE, 1), reciprocal(load1(tiles, k * TILE + k, 1))
        store(inverses, first + k, inverse)
        scaled = times(row, inverse)
        store(factors, k * TILE, scaled)
        for i in range(k + 1, TILE):
            below = load4(tiles, i * TILE, 1)
            store(
                tiles, i * TILE, less_product(below, load1(factors, k * TILE + i, 1), row)
            )
    # of rows that are not eliminated here there is no multiple to take
    factors[count * TILE * LANES : TILE * TILE * LANES] = 0.0
    f01, f02, f03 = load1(factors, 1, 1), load1(factors, 2, 1), load1(factors, 3, 1)
    f12, f13, f23 = load1(factors, 6, 1), load1(factors, 7, 1), load1(factors, 11, 1)
    for block in range(blocks):
        at, out = block * 16, (block * eliminated + first) * TILE
        row0, row1 = load4(tiles, at, 1), load4(tiles, at + 4, 1)
        row2, row3 = load4(tiles, at + 8, 1), load4(tiles, at + 12, 1)
        if block > 0:
            row1 = less_product(row1, f01, row0)
            row2 = less_product(less_product(row2, f02, row0), f12, row1)
            row3 = less_product(less_product(less_product(row3, f03, row0), f13, row1), f23, row2)
        store(upper, out, row0)
        if count > 1:
            store(upper, out + 4, row1)
        else:
            store(tiles, at + 4, row1)
        if count > 2:
            store(upper, out + 8, row2)
        else:
            store(tiles, at + 8, row2)
        if count > 3:
            store(upper, out + 12, row3)
        else:
            store(tiles, at + 12, row3)


@compiled
def solve_together(
    sigma: Array, parts: Dissection, conductance: Array, resistance: Array, fields: Array
) -> int:
    """What `elimination.solve` does, for eight samples at a time; its arguments and its answer."""
    n_electrodes = len(conductance)
    columns = (n_electrodes + TILE - 1) // TILE * TILE
    largest = (parts.size.max() + TILE - 1) // TILE
    front = _registers(largest * (largest + 1) // 2 * 16)
    stack = _registers(_stack_room(parts))
    factors = _registers(parts.eliminated.max() * TILE)
    inverses = _registers(parts.n_nodes)
    room = parts.eliminated * ((parts.size + TILE - 1) // TILE) * TILE
    upper = _registers(room.sum() if len(fields) > 0 else room.max())
    potentials = _registers((parts.n_nodes + n_electrodes) * columns if len(fields) > 0 else 0)
    conductivity = _registers(sigma.shape[1])
    schur = np.empty((n_electrodes, n_electrodes))
    for first in range(0, len(sigma), LANES):
        for lane in range(LANES):
            # Lanes without a sample repeat the last one.
            given = sigma[min(first + lane, len(sigma) - 1)]
            for k in range(len(given)):
                conductivity[k * LANES + lane] = given[k]
        rest = _condense(conductivity, parts, front, stack, upper, inverses, factors, len(fields) > 0)
        for lane in range(min(LANES, len(sigma) - first)):
            sample = first + lane
            for k in range(parts.n_nodes):
                if not 0.0 < inverses[k * LANES + lane] < np.inf:
                    return sample
            scale = 0.0
            offset = parts.eliminated[-1] % TILE
            blocks = (offset + n_electrodes + TILE - 1) // TILE
            for a in range(n_electrodes):
                for b in range(a, n_electrodes):
                    at = _tile_place(offset + a, offset + b, blocks)
                    schur[a, b] = schur[b, a] = rest[at * LANES + lane]
            for a in range(n_electrodes):
                schur[a, a] += conductance[a]
                scale += schur[a, a] / n_electrodes**2
            if not _invert(schur + scale, resistance[sample]):
                return sample
    return -1


@compiled
def _stack_room(parts: Dissection) -> int:
    """Registers that the parts whose parents have not come yet leave at most."""
    blocks = (parts.size + TILE - 1) // TILE - parts.eliminated // TILE
    left = blocks * (blocks + 1) // 2 * 16
    room, top = 0, 0
    for part in range(len(left)):
        if parts.children[part, 0] >= 0:
            for child in parts.children[part]:
                top -= left[child]
        top += left[part]
        room = max(room, top)
    return room


@compiled
def _condense(
    sigma: Array, parts: Dissection, front: Array, stack: Array, upper: Array, inverses: Array,
    factors: Array, keep: bool,
) -> Array:  # fmt: skip
    top, ended, kept = 0, 0, 0
    for part in range(len(parts.size)):
        size, eliminated = parts.size[part], parts.eliminated[part]
        blocks, first = (size + TILE - 1) // TILE, eliminated // TILE
        front[: blocks * (blocks + 1) // 2 * 16 * LANES] = 0.0
        if parts.children[part, 0] < 0:
            _assemble(front, part, sigma, parts)
        else:
            for which in (1, 0):
                child = parts.children[part, which]
                gone = parts.eliminated[child] % TILE
                count = parts.size[child] - parts.eliminated[child]
                over = (gone + count + TILE - 1) // TILE
                top -= over * (over + 1) // 2 * 16
                places = parts.places[parts.places_start[child] :][:count]
                _add(front, blocks, stack[top * LANES :], gone, over, places)
        _eliminate(front, size, eliminated, upper[kept * LANES :], inverses[ended * LANES :], factors)
        ended += eliminated
        if keep:
            kept += eliminated * blocks * TILE
        begin = _tile_place(first * TILE, first * TILE, blocks) * LANES
        over = blocks - first
        count = over * (over + 1) // 2 * 16
        stack[top * LANES : (top + count) * LANES] = front[begin : begin + count * LANES]
        top += count
    return stack


@compiled
def _assemble(front: Array, part: int, sigma: Array, parts: Dissection) -> None:
    for k in range(parts.entries_start[part], parts.entries_start[part + 1]):
        at, of, value = np.int64(parts.tile_entry[k]) * LANES, np.int64(parts.element[k]) * LANES, parts.coefficient[k]
        for lane in range(LANES):
            front[at + lane] += value * sigma[of + lane]
    for k in range(parts.fixed_start[part], parts.fixed_start[part + 1]):
        at = np.int64(parts.tile_fixed_entry[k]) * LANES
        for lane in range(LANES):
            front[at + lane] += parts.fixed[k]


@compiled
def _add(front: Array, blocks: int, child: Array, gone: int, over: int, places: Array) -> None:
    for a in range(len(places)):
        row = np.int64(places[a])
        into = _tile_place(row, 0, blocks)
        of = _tile_place(gone + a, 0, over)
        for b in range(a, len(places)):
            column = np.int64(places[b])
            at = into + column // TILE * 16 + column % TILE
            source = of + (gone + b) // TILE * 16 + (gone + b) % TILE
            store(front, at, plus(load1(front, at, 1), load1(child, source, 1)))
