"""Solving the forward problem for eight samples at a time, one in each lane of a vector register.

The elimination is that of `elimination`, arranged for arithmetic: fronts are cut into tiles of 4 x
4 entries (see `tiles`), and a tile takes all pivots before it at once, in registers.

The bits of a sample depend neither on its lane nor on the samples in the others. They differ from
those of `elimination`, which takes the same sums in another order, in the last few places.
"""

import numpy as np

from eitbench.scenarios.arrays import Array, Index
from eitbench.scenarios.compiling import compiled
from eitbench.scenarios.physics.dissection import Dissection, Place
from eitbench.scenarios.physics.registers import (
    LANES,
    WIDE,
    less_product,
    load1,
    load2,
    load4,
    load16,
    minus,
    new_registers,
    plus,
    prefetch,
    reciprocal,
    spread,
    store,
    times,
    total,
    transposed,
)
from eitbench.scenarios.physics.tiles import (
    TILE,
    Layout,
    blocks_of,
    front_room,
    tile_place,
    width_of,
)

NEAR = 4096
"""Registers that stay in the cache while they are used again and again."""
AT_ONCE, load_known = (2, load2) if WIDE else (1, load1)
"""Registers of an unknown's potentials that are substituted back at once."""
NOTHING = (0.0,) * AT_ONCE


@compiled
def solve_together(
    sigma: Array,
    parts: Dissection,
    where: Layout,
    conductance: Array,
    resistance: Array,
    fields: Array,
) -> int:
    """What `elimination.solve` does, eight samples at a time: its arguments, and the layout."""
    n_electrodes, whole = len(conductance), len(parts.size) - 1
    fronts = new_registers(where.starts[-1])
    fronts[:LANES] = 0.0
    conductivity = new_registers(sigma.shape[1])
    inverses = new_registers(parts.n_nodes + n_electrodes)
    factors = new_registers(max(parts.eliminated.max(), n_electrodes) * TILE)
    upper = new_registers(
        max((parts.eliminated * (blocks_of(parts.size) + 1)).max(), n_electrodes**2) * TILE
    )
    last = new_registers(front_room(2 * n_electrodes))
    rows = new_registers(where.rows_start[-1] if len(fields) > 0 else 0)
    pairs = (n_electrodes + 2 * LANES - 1) // (2 * LANES)
    potentials = new_registers((parts.n_nodes + n_electrodes) * 2 * pairs if len(fields) > 0 else 0)
    potentials[:] = 0.0
    alike = _alike(sigma, parts)
    saved = np.empty(_saved_start(alike, parts)[-1])
    for first in range(0, len(sigma), LANES):
        count = min(LANES, len(sigma) - first)
        for k in range(sigma.shape[1]):
            for lane in range(LANES):
                # Lanes without a sample repeat the last one.
                conductivity[k * LANES + lane] = sigma[first + min(lane, count - 1), k]
        _condense(
            conductivity, parts, where, fronts, upper, inverses, factors, rows, alike, saved,
            first > 0,
        )  # fmt: skip
        _resistances(
            fronts[where.starts[whole] * LANES :], parts.eliminated[whole], conductance, last,
            upper, inverses[parts.n_nodes * LANES :], factors,
        )  # fmt: skip
        failed = _first_failed(inverses)
        if failed < count:
            return first + failed
        for a in range(n_electrodes):
            for b in range(a, n_electrodes):
                at = tile_place(n_electrodes + a, n_electrodes + b, blocks_of(2 * n_electrodes))
                for lane in range(count):
                    of = resistance[first + lane]
                    of[a, b] = of[b, a] = -last[at * LANES + lane]
        for lane in range(count if len(fields) > 0 else 0):
            sample, sample_rows = first + lane, rows[lane * where.rows_start[-1] :]
            _find_fields(resistance[sample], sample_rows, parts, where, potentials, fields[sample])
    return -1


@compiled
def _first_failed(inverses: Array) -> int:
    """The first lane with a pivot that is not positive, or LANES."""
    sound = np.ones(LANES, dtype=np.bool_)
    for k in range(0, len(inverses), LANES):
        for lane in range(LANES):
            inverse = inverses[k + lane]
            sound[lane] &= (inverse > 0.0) & (inverse < np.inf)
    for lane in range(LANES):
        if not sound[lane]:
            return lane
    return LANES


@compiled
def _condense(
    sigma: Array, parts: Dissection, where: Layout, fronts: Array, upper: Array, inverses: Array,
    factors: Array, rows: Array, alike: Index, saved: Array, again: bool,
) -> None:  # fmt: skip
    """Leave -B^T A^-1 B in the front of the whole, and the eliminated rows in `rows`, if any.

    What is left of a part that is `alike` in all samples is `saved`, and used `again`; `inverses`
    and `rows` still have what belongs to it.
    """
    ended, start = 0, _saved_start(alike, parts)
    for part in range(len(parts.size)):
        size, eliminated = parts.size[part], parts.eliminated[part]
        front = fronts[where.starts[part] * LANES :]
        if again and alike[part] > 0:
            first = _first_left(parts, part)
            for k in range(start[part], start[part + 1]):
                store(front, first + k - start[part], 1, spread((saved[k],)))
            ended += eliminated
            continue
        if parts.children[part, 0] < 0:
            _assemble(front, part, sigma, parts, where)
        else:
            sources = where.sources[where.sources_start[part] : where.sources_start[part + 1]]
            for k in range(len(sources)):
                one, other = np.int64(sources[k, 0]), np.int64(sources[k, 1])
                store(front, k, 1, plus(load1(fronts, one, 1), load1(fronts, other, 1)))
        part_inverses = inverses[ended * LANES :]
        _eliminate(front, size, eliminated, upper, part_inverses, factors)
        if len(rows) > 0:
            _keep(
                upper, part_inverses, eliminated, size, rows[where.rows_start[part] :],
                where.rows_start[-1],
            )  # fmt: skip
        ended += eliminated
        first = _first_left(parts, part)
        for k in range(start[part], start[part + 1]):
            saved[k] = front[(first + k - start[part]) * LANES]


@compiled
def _alike(sigma: Array, parts: Dissection) -> Index:
    """(p,) 1 for parts whose elements are alike in all samples, 2 for the largest of them.

    All are 0 where that is of no use.
    """
    alike = np.zeros(len(parts.size), dtype=np.int64)
    if len(sigma) <= LANES:
        return alike
    differs = np.zeros(sigma.shape[1], dtype=np.bool_)
    for sample in range(1, len(sigma)):
        for k in range(sigma.shape[1]):
            differs[k] |= sigma[sample, k] != sigma[0, k]
    for part in range(len(parts.size)):
        one, other = parts.children[part]
        if one >= 0:
            alike[part] = min(alike[one], alike[other])
        else:
            of = parts.element[parts.entries_start[part] : parts.entries_start[part + 1]]
            alike[part] = not differs[of].any()
    for part in range(len(parts.size)):
        if parts.children[part, 0] >= 0 and alike[part] == 0:
            for child in parts.children[part]:
                alike[child] *= 2
    alike[-1] *= 2
    return alike


@compiled
def _saved_start(alike: Index, parts: Dissection) -> Index:
    """(p + 1,) where what is left of the largest parts that are alike begins in their store."""
    start = np.zeros(len(alike) + 1, dtype=np.int64)
    for part in range(len(alike)):
        room = front_room(parts.size[part]) - _first_left(parts, part)
        start[part + 1] = start[part] + (room if alike[part] == 2 else 0)
    return start


@compiled
def _first_left(parts: Dissection, part: int) -> int:
    """The first register of a front's block row that is not eliminated as a whole."""
    row = parts.eliminated[part] // TILE * TILE
    return int(tile_place(row, row, blocks_of(parts.size[part])))


@compiled
def _assemble(front: Array, part: int, sigma: Array, parts: Dissection, where: Layout) -> None:
    """Make the front of a smallest part from its elements' and electrodes' matrices."""
    front[: front_room(parts.size[part]) * LANES] = 0.0
    for k in range(parts.entries_start[part], parts.entries_start[part + 1]):
        at, of = np.int64(where.entry[k]), np.int64(parts.element[k])
        added = times(load1(sigma, of, 1), spread((parts.coefficient[k],)))
        store(front, at, 1, plus(load1(front, at, 1), added))
    for k in range(parts.fixed_start[part], parts.fixed_start[part + 1]):
        at = np.int64(where.fixed_entry[k])
        store(front, at, 1, plus(load1(front, at, 1), spread((parts.fixed[k],))))


@compiled
def _eliminate(
    front: Array, size: int, eliminated: int, upper: Array, inverses: Array, factors: Array
) -> None:
    """Eliminate the first unknowns of a front in place; what is left of it are its other rows.

    `upper` receives the eliminated rows u of the upper triangle, four columns after four, and
    `inverses` 1 / their pivots; `factors` is room for 4 registers a pivot.
    """
    blocks, whole = blocks_of(size), blocks_of(eliminated)
    for block in range(whole):
        first = block * TILE
        _take(front, block, block, blocks, first, blocks, eliminated, upper, inverses, factors)
        tiles = front[tile_place(first, first, blocks) * LANES :]
        rows = upper[(block * eliminated + first) * TILE * LANES :]
        count = min(TILE, eliminated - first)
        _pivot_rows(tiles, count, eliminated, blocks - block, rows, inverses[first * LANES :])
    if eliminated == 0:
        return
    # So many columns at a time that what is taken from all their rows stays in the cache.
    few = max(NEAR // (eliminated * TILE), 1)
    for begin in range(whole, blocks, few):
        end = min(begin + few, blocks)
        for block in range(whole, end):
            _take(
                front,
                block,
                max(block, begin),
                end,
                eliminated,
                blocks,
                eliminated,
                upper,
                inverses,
                factors,
            )


@compiled
def _take(
    front: Array, block: int, begin: int, end: int, before: int, blocks: int, eliminated: int,
    upper: Array, inverses: Array, factors: Array,
) -> None:  # fmt: skip
    """Take the first pivots, `before` of them, from the tiles begin to end of a block row.

    Where the processor has too few registers for a tile its quarters go one after another: the same
    products, with the same bits.
    """
    if before == 0:
        return
    for k in range(before):
        row = load4(upper, (block * eliminated + k) * TILE, 1)
        store(factors, k * TILE, 1, times(row, load1(inverses, k, 1)))
    tiles = front[tile_place(block * TILE, block * TILE, blocks) * LANES :]
    for column in range(begin, end):
        at, other = (column - block) * TILE**2, column * eliminated * TILE
        if WIDE:
            tile = load16(tiles, at, 1)
            for k in range(before):
                row = load4(upper, other + k * TILE, 1)
                tile = less_product(tile, load4(factors, k * TILE, 1), row)
            store(tiles, at, 1, tile)
        else:
            for r in range(0, TILE, 2):
                for c in range(0, TILE, 2):
                    one = at + r * TILE + c
                    two = one + TILE
                    quarter = load2(tiles, one, 1) + load2(tiles, two, 1)
                    for k in range(before):
                        row = load2(upper, other + k * TILE + c, 1)
                        quarter = less_product(quarter, load2(factors, k * TILE + r, 1), row)
                    store(tiles, one, 1, quarter[:2])
                    store(tiles, two, 1, quarter[2:])


@compiled
def _pivot_rows(
    tiles: Array, count: int, eliminated: int, blocks: int, upper: Array, inverses: Array
) -> None:
    """Eliminate the first `count` unknowns of a block row of tiles with each other."""
    f12 = f13 = f23 = spread((0.0,))
    row0, row1, row2, row3 = (
        load4(tiles, 0, 1), load4(tiles, 4, 1), load4(tiles, 8, 1), load4(tiles, 12, 1)
    )  # fmt: skip
    inverse = reciprocal(row0[0:1])
    store(inverses, 0, 1, inverse)
    f01, f02, f03 = times(row0[1:2], inverse), times(row0[2:3], inverse), times(row0[3:4], inverse)
    if count > 1:
        row1 = less_product(row1, f01, row0)
        inverse = reciprocal(row1[1:2])
        store(inverses, 1, 1, inverse)
        f12, f13 = times(row1[2:3], inverse), times(row1[3:4], inverse)
    if count > 2:
        row2 = less_product(less_product(row2, f02, row0), f12, row1)
        inverse = reciprocal(row2[2:3])
        store(inverses, 2, 1, inverse)
        f23 = times(row2[3:4], inverse)
    if count > 3:
        row3 = less_product(less_product(less_product(row3, f03, row0), f13, row1), f23, row2)
        store(inverses, 3, 1, reciprocal(row3[3:4]))
    for block in range(blocks):
        at, out = block * TILE**2, block * eliminated * TILE
        row0, row1 = load4(tiles, at, 1), load4(tiles, at + 4, 1)
        row2, row3 = load4(tiles, at + 8, 1), load4(tiles, at + 12, 1)
        row1 = less_product(row1, f01, row0)
        row2 = less_product(less_product(row2, f02, row0), f12, row1)
        row3 = less_product(less_product(less_product(row3, f03, row0), f13, row1), f23, row2)
        # The rows that are not eliminated here go back.
        store(upper, out, 1, row0)
        if count > 1:
            store(upper, out + 4, 1, row1)
        else:
            store(tiles, at + 4, 1, row1)
        if count > 2:
            store(upper, out + 8, 1, row2)
        else:
            store(tiles, at + 8, 1, row2)
        if count > 3:
            store(upper, out + 12, 1, row3)
        else:
            store(tiles, at + 12, 1, row3)


@compiled
def _keep(
    upper: Array, inverses: Array, eliminated: int, size: int, rows: Array, apart: int
) -> None:
    """Store the eliminated rows u / u[pivot] of a part, each sample's `apart` numbers further."""
    width = width_of(size)
    for k in range(eliminated):
        inverse = load1(inverses, k, 1)
        for column in range(k // LANES * LANES, size, LANES):
            at = (column // TILE * eliminated + k) * TILE
            row = load4(upper, at, 1) + load4(upper, at + eliminated * TILE, 1)
            of_samples = transposed(times(row, inverse))
            store(rows, (k * width + column) // LANES, apart // LANES, of_samples)


@compiled
def _resistances(
    left: Array, gone: int, conductance: Array, front: Array, upper: Array, inverses: Array,
    factors: Array,
) -> None:  # fmt: skip
    """Leave -R in the last E unknowns of a `front` of 2 E, from what is `left` of the whole.

    As in `elimination.solve`, R is the inverse of S plus a constant. Eliminating the first E
    unknowns of [[S, 1], [1, 0]] leaves -S^-1.
    """
    n = len(conductance)
    of, into = blocks_of(gone + n), blocks_of(2 * n)
    front[:] = 0.0
    scale = spread((0.0,))
    for a in range(n):
        at = tile_place(gone + a, gone + a, of)
        diagonal = plus(load1(left, at, 1), spread((conductance[a],)))
        store(left, at, 1, diagonal)
        scale = plus(scale, times(diagonal, spread((1 / n**2,))))
    for a in range(n):
        for b in range(a, n):
            entry = load1(left, tile_place(gone + a, gone + b, of), 1)
            store(front, tile_place(a, b, into), 1, plus(entry, scale))
        store(front, tile_place(a, n + a, into), 1, spread((1.0,)))
    _eliminate(front, 2 * n, n, upper, inverses, factors)


@compiled
def _find_fields(
    resistance: Array, rows: Array, parts: Dissection, where: Layout, potentials: Array,
    fields: Array,
) -> None:  # fmt: skip
    """One sample's `fields` (nodes + E, E) from its eliminated rows; `potentials` is room.

    Lanes are electrodes here: each unknown has as many pairs of registers in `potentials` as its
    potentials, one for each electrode, need.
    """
    pairs = len(potentials) // len(fields) // (2 * LANES)
    width = 2 * pairs * LANES
    for r in range(len(resistance)):
        known = potentials[(parts.n_nodes + r) * width :]
        for d in range(len(resistance)):
            known[d] = resistance[r, d]
    for part in range(len(parts.size) - 1, -1, -1):
        # Two parts ahead, or most of the time would go into waiting for memory.
        if part >= 2:
            begin, end = where.rows_start[part - 2], where.rows_start[part - 1]
            for register in range(begin // LANES, end // LANES):
                prefetch(rows, register)
        _back_substitute(part, parts, rows[where.rows_start[part] :], potentials, pairs)
    for r in range(len(fields)):
        row, out = potentials[r * width :], fields[r]
        for d in range(len(out)):
            out[d] = row[d]


@compiled
def _back_substitute(
    part: int, parts: Dissection, rows: Array, potentials: Array, pairs: int
) -> None:
    """Complete one sample's `potentials` with the unknowns that end in `part`."""
    size, eliminated = parts.size[part], parts.eliminated[part]
    unknowns = parts.unknowns[parts.unknowns_start[part] : parts.unknowns_start[part + 1]]
    width = width_of(size)
    nothing = spread(NOTHING)
    for first in range((eliminated - 1) // TILE * TILE, -1, -TILE):
        count = min(TILE, eliminated - first)
        row0 = rows[first * width + first :]
        # Missing rows repeat the last one, and are not used.
        row1, row2 = row0[min(1, count - 1) * width :], row0[min(2, count - 1) * width :]
        row3 = row0[min(3, count - 1) * width :]
        u01, u02, u03 = spread((row0[1],)), spread((row0[2],)), spread((row0[3],))
        u12, u13, u23 = spread((row1[2],)), spread((row1[3],)), spread((row2[3],))
        row0, row1, row2, row3 = row0[count:], row1[count:], row2[count:], row3[count:]
        others = unknowns[first + count :]
        for lanes in range(0, 2 * pairs, AT_ONCE):
            x0 = x1 = x2 = x3 = nothing
            for k in range(len(others)):
                known = load_known(potentials, np.int64(others[k]) * 2 * pairs + lanes, 1)
                x0 = less_product(x0, spread((row0[k],)), known)
                x1 = less_product(x1, spread((row1[k],)), known)
                x2 = less_product(x2, spread((row2[k],)), known)
                x3 = less_product(x3, spread((row3[k],)), known)
            if count > 3:
                store(potentials, np.int64(unknowns[first + 3]) * 2 * pairs + lanes, 1, x3)
                x0, x1 = less_product(x0, u03, x3), less_product(x1, u13, x3)
                x2 = less_product(x2, u23, x3)
            if count > 2:
                store(potentials, np.int64(unknowns[first + 2]) * 2 * pairs + lanes, 1, x2)
                x0, x1 = less_product(x0, u02, x2), less_product(x1, u12, x2)
            if count > 1:
                store(potentials, np.int64(unknowns[first + 1]) * 2 * pairs + lanes, 1, x1)
                x0 = less_product(x0, u01, x1)
            store(potentials, np.int64(unknowns[first]) * 2 * pairs + lanes, 1, x0)


@compiled
def gradients_together(
    fields: Array, weights: Array, corners: Place, couplings: Array, gradient: Array
) -> None:
    """What `elimination.element_gradients` does, with electrodes in the lanes of registers.

    Since the rows and columns of an element's matrix add up to 0, u^T K w needs only the
    differences of u and of w to their values at the last corner, and K without that corner.
    """
    nodes, n_electrodes = fields.shape[1:]
    width = (n_electrodes + LANES - 1) // LANES
    rows = blocks_of(nodes) * TILE
    y, z = new_registers(rows * width), new_registers(rows * width)
    weight = new_registers(n_electrodes * width)
    y[:], weight[:] = 0.0, 0.0
    for sample in range(len(fields)):
        for r in range(n_electrodes):
            for d in range(n_electrodes):
                weight[r * width * LANES + d] = weights[sample, r, d]
        # z = -y weights
        for r in range(0, rows, TILE):
            for i in range(min(TILE, nodes - r)):
                row, of = y[(r + i) * width * LANES :], fields[sample, r + i]
                for d in range(len(of)):
                    row[d] = of[d]
            row0, row1 = y[r * width * LANES :], y[(r + 1) * width * LANES :]
            row2, row3 = y[(r + 2) * width * LANES :], y[(r + 3) * width * LANES :]
            for d in range(width):
                tile = spread((0.0, 0.0, 0.0, 0.0))
                for c in range(n_electrodes):
                    column = spread((row0[c], row1[c], row2[c], row3[c]))
                    tile = less_product(tile, column, load1(weight, c * width + d, 1))
                store(z, r * width + d, width, tile)
        for k in range(len(corners)):
            at, of = corners[k], couplings[k]
            at0, at1 = np.int64(at[0]) * width, np.int64(at[1]) * width
            at2, at3 = np.int64(at[2]) * width, np.int64(at[3]) * width
            k01, k02, k12 = spread((of[0],)), spread((of[1],)), spread((of[3],))
            k0 = spread((of[0] + of[1] + of[2],))
            k1 = spread((of[0] + of[3] + of[4],))
            k2 = spread((of[1] + of[3] + of[5],))
            sums = spread((0.0,))
            for d in range(width):
                y3, z3 = load1(y, at3 + d, 1), load1(z, at3 + d, 1)
                y0, z0 = minus(load1(y, at0 + d, 1), y3), minus(load1(z, at0 + d, 1), z3)
                y1, z1 = minus(load1(y, at1 + d, 1), y3), minus(load1(z, at1 + d, 1), z3)
                y2, z2 = minus(load1(y, at2 + d, 1), y3), minus(load1(z, at2 + d, 1), z3)
                # -K y
                flow0 = less_product(less_product(times(y0, k0), k01, y1), k02, y2)
                flow1 = less_product(less_product(times(y1, k1), k01, y0), k12, y2)
                flow2 = less_product(less_product(times(y2, k2), k02, y0), k12, y1)
                sums = less_product(sums, flow0, z0)
                sums = less_product(sums, flow1, z1)
                sums = less_product(sums, flow2, z2)
            gradient[sample, k] = total(sums)
