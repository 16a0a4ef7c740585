"""Fronts as tiles: where the numbers of a dissection are when eight samples go side by side.

Of a front's tiles of 4 x 4 entries, block row after block row, only those of the upper triangle
exist; a tile is 16 registers, row after row.

numba keeps machine code until the module that is compiled changes: after a change here, touch
`side_by_side`.
"""

from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from eitbench.scenarios.arrays import Index
from eitbench.scenarios.physics.dissection import Dissection, Place, stride
from eitbench.scenarios.physics.registers import LANES

TILE = 4
Whole = Any  # a whole number, or an array of them


class Layout(NamedTuple):
    """Where the registers of a dissection's fronts and the numbers of its eliminated rows are.

    Attributes:
        starts: (p + 1,) the first register of each front, and the number of registers; a front is
            overwritten when that of its parent is complete. Register 0 is 0.
        entry, fixed_entry: those of the dissection, as registers of the front.
        sources, sources_start: (t, 2) the registers, one of each child, that add up to the
            registers of a front, one after another.
        rows_start: (p + 1,) where a part's eliminated rows begin in the store of one sample.
    """

    starts: Index
    entry: Place
    fixed_entry: Place
    sources: Place
    sources_start: Index
    rows_start: Index


def layout(parts: Dissection) -> Layout:
    """The layout of a dissection."""
    n, blocks = len(parts.size), blocks_of(parts.size)
    starts = _front_starts(parts)
    # The dissection's fronts lie row after row.
    strides = np.array([stride(size) for size in parts.size.tolist()])
    of = [np.repeat(np.arange(n), np.diff(at)) for at in (parts.entries_start, parts.fixed_start)]
    entry, fixed_entry = (
        tile_place(*np.divmod(at.astype(np.int64), strides[part]), blocks[part])
        for at, part in zip((parts.entry, parts.fixed_entry), of, strict=True)
    )
    sources = []
    for part, children in enumerate(parts.children):
        row, column = _tile_entries(int(blocks[part]) if children[0] >= 0 else 0)
        found = np.zeros((len(row), 2), dtype=np.int64)
        for which, child in enumerate(children if len(row) else ()):
            gone, remaining = parts.eliminated[child], parts.size[child] - parts.eliminated[child]
            where = np.full(blocks[part] * TILE, -1)
            places = parts.places[parts.places_start[child] :][:remaining]
            where[places] = gone + np.arange(remaining)
            a, b = where[row], where[column]
            place = starts[child] + tile_place(a, b, blocks[child])
            found[:, which] = np.where((a >= 0) & (b >= a), place, 0)
        sources.append(found)
    return Layout(
        starts,
        entry.astype(np.uint32),
        fixed_entry.astype(np.uint32),
        np.concatenate(sources).astype(np.uint32),
        np.cumsum([0, *map(len, sources)]),
        np.cumsum([0, *(parts.eliminated * width_of(parts.size))]),
    )


def _front_starts(parts: Dissection) -> Index:
    """Parts equally many cuts below the whole share two places: first children, second children."""
    place = np.zeros(len(parts.size), dtype=np.int64)
    room = np.zeros(2 * len(parts.size), dtype=np.int64)
    for part in range(len(parts.size) - 1, -1, -1):
        room[place[part]] = max(room[place[part]], front_room(parts.size[part]))
        if parts.children[part, 0] >= 0:
            place[parts.children[part]] = place[part] // 2 * 2 + np.array([2, 3])
    return np.append((1 + np.cumsum(room) - room)[place], 1 + room.sum())


def _tile_entries(blocks: int) -> tuple[Index, Index]:
    """Row and column of every register of a front."""
    row, column = (TILE * k[:, None, None] for k in np.triu_indices(blocks))
    within = np.arange(TILE)
    shape = (len(row), TILE, TILE)
    return (
        np.broadcast_to(row + within[:, None], shape).ravel(),
        np.broadcast_to(column + within, shape).ravel(),
    )


@register_jitable
def tile_place(row: Whole, column: Whole, blocks: Whole) -> Whole:
    """The register of an entry of the upper triangle in a front of so many blocks."""
    above = row // TILE
    tile = above * blocks - above * (above + 1) // 2 + column // TILE
    return tile * TILE**2 + row % TILE * TILE + column % TILE


@register_jitable
def blocks_of(size: Whole) -> Whole:
    """Block rows of a front."""
    return (size + TILE - 1) // TILE


@register_jitable
def front_room(size: Whole) -> Whole:
    """Registers of a front."""
    return blocks_of(size) * (blocks_of(size) + 1) // 2 * TILE**2


@register_jitable
def width_of(size: Whole) -> Whole:
    """Numbers between the eliminated rows of a sample."""
    return (size + LANES - 1) // LANES * LANES
