"""Solving the forward problem part by part: compiled loops over the fronts of a dissection.

Everything is float64, and one sample after another on one thread, so that the bits of a sample
depend on nothing beside it. Batches are solved faster by `side_by_side`.
"""

import numpy as np

from eitbench.scenarios.arrays import Array, Index
from eitbench.scenarios.compiling import compiled
from eitbench.scenarios.physics.dissection import Dissection, Place, stride

PIVOTS = 4  # rows eliminated at a time


_stride = compiled(stride)


@compiled
def _eliminate(front: Array, eliminated: int, kept: Array, panel: Array, scaled: Array) -> bool:
    """Eliminate the first unknowns of a front, in place; False if it is not positive definite.

    With rows u of the upper triangle, a pivot's step is front[r, c] -= u[r] / u[pivot] * u[c];
    PIVOTS of them are taken together, on two rows r at a time. `kept` receives the rows
    u / u[pivot]; the front's last row is padding.
    """
    size, width = len(front) - 1, front.shape[1]
    for first in range(0, eliminated, PIVOTS):
        count = min(PIVOTS, eliminated - first)
        start = first // 8 * 8
        for k in range(count):
            r = first + k
            row, u, v = front[r, start:], panel[k, start:width], scaled[k, start:width]
            for before in range(k):
                factor, other = scaled[before, r], panel[before, start:width]
                for c in range(len(row)):
                    row[c] -= factor * other[c]
            pivot = front[r, r]
            if not pivot > 0.0:
                return False
            inverse, keep = 1.0 / pivot, kept[r, start:]
            for c in range(len(row)):
                u[c] = row[c]
                v[c] = row[c] * inverse
                keep[c] = v[c]
        for k in range(count, PIVOTS):
            panel[k, start:width] = 0.0
            scaled[k, start:width] = 0.0
        for r in range(first + count, size, 2):
            start = r // 8 * 8
            one, two = front[r, start:], front[r + 1, start:]
            u0, u1 = panel[0, start:width], panel[1, start:width]
            u2, u3 = panel[2, start:width], panel[3, start:width]
            a0, a1, a2, a3 = scaled[0, r], scaled[1, r], scaled[2, r], scaled[3, r]
            b0, b1 = scaled[0, r + 1], scaled[1, r + 1]
            b2, b3 = scaled[2, r + 1], scaled[3, r + 1]
            for c in range(len(one)):
                one[c] -= a0 * u0[c] + a1 * u1[c] + a2 * u2[c] + a3 * u3[c]
                two[c] -= b0 * u0[c] + b1 * u1[c] + b2 * u2[c] + b3 * u3[c]
    return True


@compiled
def _assemble(front: Array, part: int, sigma: Array, parts: Dissection) -> None:
    """Add the elements' and electrodes' matrices of a smallest part to its front."""
    flat = front.ravel()
    for k in range(parts.entries_start[part], parts.entries_start[part + 1]):
        flat[parts.entry[k]] += parts.coefficient[k] * sigma[parts.element[k]]
    for k in range(parts.fixed_start[part], parts.fixed_start[part + 1]):
        flat[parts.fixed_entry[k]] += parts.fixed[k]


@compiled
def solve(
    sigma: Array, parts: Dissection, conductance: Array, resistance: Array, fields: Array
) -> int:
    """Electrode resistances R and, if asked for, the potentials Y = A^-1 B R, sample by sample.

    Args:
        sigma: (n, k) conductivity of the elements [S/m].
        conductance: (E,) of the electrodes [S].
        resistance: (n, E, E) receives R [Ohm].
        fields: (n, nodes + E, E) receives Y, then R [V per A]; or (0, nodes + E, E) for no fields.

    Returns:
        The number of the first sample whose matrix is not positive definite, or -1.
    """
    n_electrodes = len(conductance)
    largest = parts.size.max()
    work = np.empty((largest + 1) * _stride(largest))
    panel, scaled = np.empty((PIVOTS, _stride(largest))), np.empty((PIVOTS, _stride(largest)))
    stack = np.empty(_stack_room(parts))
    factors = np.empty(parts.factor_start[-1])
    front = np.zeros(((n_electrodes + 3) // 4 * 4, largest))
    for sample in range(len(sigma)):
        schur = _condense(sigma[sample], parts, factors, work, stack, panel, scaled)
        if len(schur) == 0:
            return sample
        scale = 0.0
        for a in range(n_electrodes):
            schur[a, a] += conductance[a]
            scale += schur[a, a] / n_electrodes**2
        # S has the constants as its kernel; adding them makes it regular, and adds a constant to
        # every column of R, which no voltage sees.
        if not _invert(schur + scale, resistance[sample]):
            return sample
        if len(fields) > 0:
            potentials = fields[sample]
            potentials[parts.n_nodes :] = resistance[sample]
            for part in range(len(parts.size) - 1, -1, -1):
                _back_substitute(part, factors, parts, potentials, front)
    return -1


@compiled
def _invert(matrix: Array, inverse: Array) -> bool:
    """Gauss-Jordan elimination of a positive definite `matrix`, in place; False if it is not.

    As small as it is, a library would take longer to call, and might start threads.
    """
    n = len(matrix)
    inverse[:] = 0.0
    for k in range(n):
        inverse[k, k] = 1.0
    for k in range(n):
        pivot = matrix[k, k]
        if not pivot > 0.0:
            return False
        matrix[k] /= pivot
        inverse[k] /= pivot
        for r in range(n):
            if r != k:
                factor = matrix[r, k]
                matrix[r] -= factor * matrix[k]
                inverse[r] -= factor * inverse[k]
    for a in range(n):
        for b in range(a):
            inverse[a, b] = inverse[b, a] = (inverse[a, b] + inverse[b, a]) / 2
    return True


@compiled
def _stack_room(parts: Dissection) -> int:
    """Numbers that the parts whose parents have not come yet leave at most, and some to spare."""
    rest = parts.size - parts.eliminated
    room, top = 0, 0
    for part in range(len(rest)):
        if parts.children[part, 0] >= 0:
            for child in parts.children[part]:
                top -= rest[child] ** 2
        top += rest[part] ** 2
        room = max(room, top)
    return room


@compiled
def _condense(
    sigma: Array,
    parts: Dissection,
    factors: Array,
    work: Array,
    stack: Array,
    panel: Array,
    scaled: Array,
) -> Array:
    """-B^T A^-1 B (E, E) [S] of one sample, empty if its matrix is not positive definite."""
    top = 0
    for part in range(len(parts.size)):
        size, eliminated = parts.size[part], parts.eliminated[part]
        width, remaining = _stride(size), size - eliminated
        front = work[: (size + 1) * width].reshape(size + 1, width)
        front[:] = 0.0
        if parts.children[part, 0] < 0:
            _assemble(front, part, sigma, parts)
        else:
            for which in (1, 0):
                child = parts.children[part, which]
                count = parts.size[child] - parts.eliminated[child]
                top -= count * count
                places = parts.places[parts.places_start[child] :][:count]
                for a in range(count):
                    row, added = front[places[a]], stack[top + a * count :][:count]
                    for b in range(a, count):
                        row[places[b]] += added[b]
        rows = factors[parts.factor_start[part] : parts.factor_start[part + 1]]
        if not _eliminate(front, eliminated, rows.reshape(eliminated, width), panel, scaled):
            return np.empty((0, 0))
        for a in range(remaining):
            row, out = front[eliminated + a, eliminated:size], stack[top + a * remaining :]
            for b in range(a, remaining):
                out[b] = row[b]
        top += remaining**2
    schur = np.empty((remaining, remaining))
    for a in range(remaining):
        for b in range(a, remaining):
            schur[a, b] = schur[b, a] = stack[a * remaining + b]
    return schur


@compiled
def _back_substitute(
    part: int, factors: Array, parts: Dissection, fields: Array, front: Array
) -> None:
    """Complete `fields` (nodes + E, d) with the potentials of the unknowns that end in `part`."""
    size, eliminated = parts.size[part], parts.eliminated[part]
    unknowns = parts.unknowns[parts.unknowns_start[part] : parts.unknowns_start[part + 1]]
    width = _stride(size)
    rows = factors[parts.factor_start[part] : parts.factor_start[part + 1]]
    rows = rows.reshape(eliminated, width)
    for r in range(eliminated, size):
        known = fields[unknowns[r]]
        for d in range(len(known)):
            front[d, r] = known[d]
    for r in range(eliminated - 1, -1, -1):
        row = rows[r, r + 1 : size]
        # Four sums at a time, over long rows: that is what vector registers are for.
        for d in range(0, len(front), 4):
            x0, x1 = front[d, r + 1 : size], front[d + 1, r + 1 : size]
            x2, x3 = front[d + 2, r + 1 : size], front[d + 3, r + 1 : size]
            t0, t1, t2, t3 = 0.0, 0.0, 0.0, 0.0
            for c in range(len(row)):
                t0 += row[c] * x0[c]
                t1 += row[c] * x1[c]
                t2 += row[c] * x2[c]
                t3 += row[c] * x3[c]
            front[d, r], front[d + 1, r], front[d + 2, r], front[d + 3, r] = -t0, -t1, -t2, -t3
    for r in range(eliminated):
        found = fields[unknowns[r]]
        for d in range(len(found)):
            found[d] = front[d, r]


@compiled
def _times(y: Array, weights: Array, z: Array) -> None:
    """z = y @ weights for y (n, E) and weights (E, E), without a library's threads."""
    for r in range(len(y)):
        row, out = y[r], z[r]
        out[:] = 0.0
        for c in range(len(row)):
            factor, of = row[c], weights[c]
            for d in range(len(out)):
                out[d] += factor * of[d]


@compiled
def element_gradients(
    fields: Array, weights: Array, corners: Place, couplings: Array, gradient: Array
) -> None:
    """gradient[s, e] = -sum(weights[s] * (Y_e^T K_e Y_e)), with Y_e the fields at e's corners.

    Since the rows of an element's matrix add up to 0, u^T K w = -sum_(i<j) K_ij (u_i - u_j)(w_i -
    w_j): an element is a network of resistors between its corners.

    Args:
        fields: (n, nodes + E, E) Y.
        weights: (n, E, E) symmetric.
        corners: (k, 4) nodes of every element.
        couplings: (k, 6) K_ij of the pairs of corners 01, 02, 03, 12, 13, 23.
        gradient: (n, k) receives the result.
    """
    z = np.empty(fields.shape[1:])
    for sample in range(len(fields)):
        y = fields[sample]
        _times(y, weights[sample], z)
        for k in range(len(corners)):
            at, of = corners[k], couplings[k]
            y0, y1, y2, y3 = y[at[0]], y[at[1]], y[at[2]], y[at[3]]
            z0, z1, z2, z3 = z[at[0]], z[at[1]], z[at[2]], z[at[3]]
            k01, k02, k03, k12, k13, k23 = of[0], of[1], of[2], of[3], of[4], of[5]
            total = 0.0
            for d in range(y.shape[1]):
                total += (
                    k01 * (y0[d] - y1[d]) * (z0[d] - z1[d])
                    + k02 * (y0[d] - y2[d]) * (z0[d] - z2[d])
                    + k03 * (y0[d] - y3[d]) * (z0[d] - z3[d])
                    + k12 * (y1[d] - y2[d]) * (z1[d] - z2[d])
                    + k13 * (y1[d] - y3[d]) * (z1[d] - z3[d])
                    + k23 * (y2[d] - y3[d]) * (z2[d] - z3[d])
                )
            gradient[sample, k] = total


@compiled
def sensitivities(
    fields: Array, drives: Index, senses: Index, corners: Place, couplings: Array, result: Array
) -> None:
    """result[m, e] = -u_m^T K_e w_m, with u the field of a drive pair and w of a measuring pair.

    Args:
        fields: (nodes + E, E) Y of one sample.
        drives, senses: (M, 2) the electrodes +1 A goes into and out of, in u_m and in w_m.
        corners, couplings: as for `element_gradients`.
        result: (M, k) receives the result.
    """
    n_electrodes = fields.shape[1]
    # Element by element is too little work at a time, all at once too much for the cache.
    block = 64
    slope = np.empty((n_electrodes, 6, block))
    flux = np.empty((n_electrodes, 6, block))
    for start in range(0, len(corners), block):
        count = min(block, len(corners) - start)
        for k in range(count):
            at, of = corners[start + k], couplings[start + k]
            pair = 0
            for i in range(4):
                for j in range(i + 1, 4):
                    yi, yj = fields[at[i]], fields[at[j]]
                    for e in range(n_electrodes):
                        slope[e, pair, k] = yi[e] - yj[e]
                        flux[e, pair, k] = of[pair] * slope[e, pair, k]
                    pair += 1
        for m in range(len(drives)):
            total = result[m, start : start + count]
            total[:] = 0.0
            for pair in range(6):
                into, out = flux[drives[m, 0], pair], flux[drives[m, 1], pair]
                plus, minus = slope[senses[m, 0], pair], slope[senses[m, 1], pair]
                for k in range(len(total)):
                    total[k] += (into[k] - out[k]) * (plus[k] - minus[k])
