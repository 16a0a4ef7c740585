"""Nested dissection: in which order the unknowns of a mesh are eliminated, and with which others.

The elements are cut in halves again and again (George 1973). Eliminating, from the smallest parts
upwards, the nodes that no other part shares couples every part only to its own rim, so that a grid
of n x n elements costs O(n^3) operations instead of the O(n^4) of a banded elimination. The dense
matrix of one part, its own unknowns first, is called its front (Duff and Reid 1983).

Unknowns are the mesh's n nodes, then its E electrodes, which are never eliminated.
"""

from collections import Counter
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.arrays import Array, Index
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.elements import ElectrodeTerms, stiffness
from eitbench.scenarios.physics.mesh import Mesh
from eitbench.scenarios.physics.registers import LANES

Place = NDArray[np.uint32]  # unsigned: compiled loops need not look for negative indices

# Parts of this many elements are not cut further: smaller ones spend their time on bookkeeping,
# larger ones on arithmetic (measured: `make bench`).
LEAF_ELEMENTS = 16


class Dissection(NamedTuple):
    """The parts of a mesh, children before parents, the whole last; all that does not vary.

    Ragged lists are stored one after another; those of part p are at [start[p], start[p + 1]).

    Attributes:
        n_nodes: n.
        size, eliminated: (p,) unknowns of each front, and how many of them, the first, end here.
        children: (p, 2) the parts that a part consists of; -1 for the smallest.
        unknowns, unknowns_start: the unknowns of each front; its electrodes come last.
        places, places_start: where in the parent's front each remaining unknown of a part goes.
        entry, entries_start, element, coefficient: front[entry] += coefficient * sigma[element].
        fixed_entry, fixed_start, fixed: front[fixed_entry] += fixed, the electrodes' share.
        factor_start: (p + 1,) where the eliminated rows of each front begin in the store.
    """

    n_nodes: int
    size: Index
    eliminated: Index
    children: Index
    unknowns: Place
    unknowns_start: Index
    places: Place
    places_start: Index
    entry: Place
    entries_start: Index
    element: Place
    coefficient: Array
    fixed_entry: Place
    fixed_start: Index
    fixed: Array
    factor_start: Index


def stride(size: int) -> int:
    """Numbers between the rows of a front of `size` unknowns: at least one more than it has.

    Rows begin at multiples of the width of a vector register.
    """
    return (size // LANES + 1) * LANES


def dissect(mesh: Mesh, terms: ElectrodeTerms) -> Dissection:
    """The dissection of `mesh` with its electrodes' terms.

    Raises:
        InputError: an electrode that lies outside the part of the rim that the mesh gives it.
    """
    parts, (first, second) = _structure(mesh)
    n = len(mesh.nodes)
    of_nodes = second < n
    values = np.empty(len(first))
    values[of_nodes] = terms.mass[first[of_nodes], second[of_nodes]]
    values[~of_nodes] = -terms.coupling[first[~of_nodes], second[~of_nodes] - n]
    if np.count_nonzero(values[~of_nodes]) < np.count_nonzero(terms.coupling):
        raise InputError(
            "An electrode lies too far from the place for which the mesh was made, or the mesh is "
            "too coarse for so many: use a finer image_shape, or fewer electrodes."
        )
    return parts._replace(fixed=values)


# Sensors whose electrodes lie a little elsewhere share all but the electrodes' values.
@lru_cache(maxsize=8)
def _structure(mesh: Mesh) -> tuple[Dissection, Index]:
    """The dissection without `fixed`, and the pairs (2, t) of unknowns whose terms it takes."""
    pairs = _electrode_pairs(mesh)
    n_nodes, corners = len(mesh.nodes), mesh.elements
    parts, children = _cut(mesh.nodes[corners].mean(axis=1))
    owner = _owners(corners, parts, pairs)
    owned = [np.flatnonzero(owner == p) for p in range(len(parts))]
    leaf_unknowns = [
        np.union1d(corners[part], pairs[terms]) for part, terms in zip(parts, owned, strict=True)
    ]
    eliminated, remaining = _order(leaf_unknowns, children, n_nodes)
    fronts = [np.concatenate([e, r]) for e, r in zip(eliminated, remaining, strict=True)]

    where = [{u: k for k, u in enumerate(front.tolist())} for front in fronts]
    places: list[list[int]] = [[] for _ in fronts]
    for parent, pair in enumerate(children):
        for child in pair:
            places[child] = [where[parent][u] for u in remaining[child].tolist()]

    local = stiffness(mesh)
    entries, elements, coefficients, fixed_entries = [], [], [], []
    i, j = np.triu_indices(corners.shape[1])
    for p, part in enumerate(parts):
        order = np.argsort(fronts[p])
        at = order[np.searchsorted(fronts[p], corners[part], sorter=order)]
        # Element matrices are symmetric, and of fronts only the upper triangle is used.
        row, column = np.minimum(at[:, i], at[:, j]), np.maximum(at[:, i], at[:, j])
        entries.append((row * stride(len(fronts[p])) + column).ravel())
        elements.append(np.repeat(part, len(i)))
        coefficients.append(local[part][:, i, j].ravel())
        ends = [sorted(where[p][u] for u in pair) for pair in pairs[owned[p]].tolist()]
        fixed_entries.append(np.array([r * stride(len(fronts[p])) + c for r, c in ends], int))

    size = np.array([len(front) for front in fronts])
    counts = np.array([len(e) for e in eliminated])
    kept = [count * stride(s) for count, s in zip(counts, size, strict=True)]
    dissection = Dissection(
        n_nodes,
        size,
        counts,
        np.array([pair or (-1, -1) for pair in children], dtype=np.int64),
        *_ragged(fronts),
        *_ragged([np.array(p, dtype=np.int64) for p in places]),
        *_ragged(entries),
        np.concatenate(elements).astype(np.uint32),
        np.concatenate(coefficients),
        *_ragged(fixed_entries),
        np.empty(0),
        np.cumsum([0, *kept]),
    )
    return dissection, np.ascontiguousarray(pairs[np.concatenate(owned)].T)


def _electrode_pairs(mesh: Mesh) -> Index:
    """Pairs (t, 2) of unknowns that an electrode anywhere in its part of the rim can couple."""
    one, other = mesh.rim_edges.T
    of_nodes = np.column_stack([np.minimum(one, other), np.maximum(one, other)])
    ends = np.repeat(mesh.rim_edges, 2, axis=1).reshape(-1, 2, 2)
    reached = np.tile(mesh.rim_electrodes, 2).reshape(-1, 2, 2)
    of_electrodes = np.column_stack([ends.ravel(), len(mesh.nodes) + reached.ravel()])
    alone = np.column_stack([one, one])
    return np.unique(np.concatenate([of_nodes, alone, of_electrodes]), axis=0)


def _cut(centres: Array) -> tuple[list[Index], list[tuple[int, ...]]]:
    """Elements of every smallest part (none for the others), and the children of every part."""
    parts: list[Index] = []
    children: list[tuple[int, ...]] = []
    extent = np.ptp(centres)

    def add(elements: Index) -> int:
        pair: tuple[int, ...] = ()
        if len(elements) > LEAF_ELEMENTS:
            here = centres[elements]
            width, height = np.ptp(here, axis=0)
            along = here[:, 0 if width > height * (1 + 1e-9) else 1]
            # Between two lines of the grid, so that the cut is straight.
            levels = np.unique(np.round(along / extent, 9)) * extent
            low = along < (levels[len(levels) // 2 - 1] + levels[len(levels) // 2]) / 2
            pair = (add(elements[low]), add(elements[~low]))
        parts.append(elements[:0] if pair else elements)
        children.append(pair)
        return len(parts) - 1

    add(np.arange(len(centres)))
    return parts, children


def _owners(corners: Index, parts: list[Index], pairs: Index) -> Index:
    """The smallest part (t,) that each electrode's term between `pairs` (t, 2) is given to."""
    part_of = np.empty(len(corners), dtype=np.int64)
    for p, part in enumerate(parts):
        part_of[part] = p
    elements_at: dict[int, set[int]] = {}
    for element, node in zip(*np.nonzero(np.isin(corners, pairs)), strict=True):
        elements_at.setdefault(int(corners[element, node]), set()).add(int(element))
    # An electrode lies at no element's corner: its node's elements decide.
    shared = [elements_at[i] & elements_at.get(j, elements_at[i]) for i, j in pairs.tolist()]
    return part_of[[min(elements) for elements in shared]]


def _order(
    leaf_unknowns: list[Index], children: list[tuple[int, ...]], n_nodes: int
) -> tuple[list[Index], list[Index]]:
    """The unknowns that end in each part, and those that remain, in the order they end later."""
    uses = np.bincount(np.concatenate(leaf_unknowns))
    ends = np.arange(len(uses))  # electrodes, numbered after all nodes, end after all nodes
    n_ended = 0
    eliminated: list[Index] = []
    seen: list[Counter[int]] = []
    for unknowns, pair in zip(leaf_unknowns, children, strict=True):
        # How many smallest parts of this part use an unknown; when all do, it ends here.
        here = Counter(unknowns.tolist())
        for child in pair:
            here.update(seen[child])
        done = sorted(u for u, count in here.items() if u < n_nodes and count == uses[u])
        ends[done] = n_ended + np.arange(len(done))
        n_ended += len(done)
        eliminated.append(np.array(done, dtype=np.int64))
        seen.append(here - Counter({u: here[u] for u in done}))
    # One order for all parts: places in a parent's front then increase, too.
    remaining = [
        np.array(sorted(here, key=lambda u: int(ends[u])), dtype=np.int64) for here in seen
    ]
    return eliminated, remaining


def _ragged(lists: list[Index]) -> tuple[Place, Index]:
    starts = np.cumsum([0, *(len(values) for values in lists)])
    return np.concatenate(lists).astype(np.uint32), starts
