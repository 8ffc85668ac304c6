"""Element kernels compiled with Numba: the inner loops of the mechanics on the CPU.

The kernels release the GIL, so that load cases run in parallel threads. They take the derivatives
of the strain energy by the invariants I1, I2, J and do not depend on the material.

For a node with shape gradient g: p = dI1/dF g = 2 F g, t = dI2/dF g, c = dJ/dF g = cof(F) g.
"""

from contextlib import ExitStack
from typing import Any, no_type_check

import numba
import numpy as np
from numba.core import event

from tactorch.progress import noted

_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "cache": True,
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
    "error_model": "numpy",
}


class _Announcer(event.Listener):
    """Shows that kernels are compiled; Numba compiles one at a time, with others inside it."""

    def __init__(self) -> None:
        self._depth, self._stack = 0, ExitStack()

    def on_start(self, event: event.Event) -> None:
        """Begin with the outermost kernel."""
        self._depth += 1
        if self._depth == 1:
            self._stack.enter_context(noted("compiling, which is kept for later runs"))

    def on_end(self, event: event.Event) -> None:
        """End with the outermost kernel."""
        self._depth -= 1
        if self._depth == 0:
            self._stack.close()


event.register("numba:compile", _Announcer())


@no_type_check
@numba.njit(**_OPTIONS)
def kinematics(nodes, gradients, u, F, cofactors, invariants):
    """Fill F and cof(F) (m, q, 3, 3) and invariants (3, m, q) from displacements u (n, 3)."""
    for e in range(gradients.shape[0]):
        for q in range(gradients.shape[1]):
            M = F[e, q]
            cof = cofactors[e, q]
            for i in range(3):
                for k in range(3):
                    M[i, k] = 1.0 if i == k else 0.0
            for a in range(gradients.shape[2]):
                node = nodes[e, a]
                for i in range(3):
                    ui = u[node, i]
                    for k in range(3):
                        M[i, k] += ui * gradients[e, q, a, k]
            trace = 0.0
            square = 0.0
            for i in range(3):
                i1 = (i + 1) % 3
                i2 = (i + 2) % 3
                for k in range(3):
                    k1 = (k + 1) % 3
                    k2 = (k + 2) % 3
                    cof[i, k] = M[i1, k1] * M[i2, k2] - M[i1, k2] * M[i2, k1]
                    c = M[0, i] * M[0, k] + M[1, i] * M[1, k] + M[2, i] * M[2, k]
                    square += c * c
                    if i == k:
                        trace += c
            invariants[0, e, q] = trace
            invariants[1, e, q] = 0.5 * (trace * trace - square)
            invariants[2, e, q] = M[0, 0] * cof[0, 0] + M[0, 1] * cof[0, 1] + M[0, 2] * cof[0, 2]


@no_type_check
@numba.njit(**_OPTIONS)
def element_forces(gradients, weights, F, cofactors, invariants, d1, d2, dj, out):
    """Fill the elements' nodal forces (m, s, k, 3): sums over points of weight * P g, P the stress.

    There is one sum an element (s = 1), or one for each quadrature point (s = q).
    """
    P = np.empty((3, 3))
    for e in range(F.shape[0]):
        out[e] = 0.0
        for q in range(F.shape[1]):
            s = min(q, out.shape[1] - 1)
            M = F[e, q]
            w = weights[e, q]
            s2 = 2.0 * w * d2[e, q]
            s1 = 2.0 * w * d1[e, q] + s2 * invariants[0, e, q]
            sj = w * dj[e, q]
            for i in range(3):
                for k in range(3):
                    P[i, k] = s1 * M[i, k] + sj * cofactors[e, q, i, k]
            if s2 != 0.0:
                for i in range(3):
                    for j in range(3):
                        b = s2 * (M[i, 0] * M[j, 0] + M[i, 1] * M[j, 1] + M[i, 2] * M[j, 2])
                        for k in range(3):
                            P[i, k] -= b * M[j, k]
            g = gradients[e, q]
            for a in range(g.shape[0]):
                for i in range(3):
                    out[e, s, a, i] += P[i, 0] * g[a, 0] + P[i, 1] * g[a, 1] + P[i, 2] * g[a, 2]


@no_type_check
@numba.njit(**_OPTIONS)
def add_mean_forces(gradients, weights, cofactors, mean, out):
    """Add the forces of an averaged volumetric energy U to `out`; see `element_forces`.

    `mean` is dU/dJ of each element, (m,). U is the same at all points of an element, so that each
    has a force in proportion to its volume.
    """
    average = np.empty(out.shape[2:])
    for e in range(gradients.shape[0]):
        volume = 0.0
        average[:] = 0.0
        for q in range(gradients.shape[1]):
            w = weights[e, q]
            cof = cofactors[e, q]
            g = gradients[e, q]
            volume += w
            for a in range(g.shape[0]):
                for i in range(3):
                    average[a, i] += w * (
                        cof[i, 0] * g[a, 0] + cof[i, 1] * g[a, 1] + cof[i, 2] * g[a, 2]
                    )
        for s in range(out.shape[1]):
            share = mean[e] * (weights[e, s] / volume if out.shape[1] > 1 else 1.0)
            for a in range(average.shape[0]):
                for i in range(3):
                    out[e, s, a, i] += share * average[a, i]


@no_type_check
@numba.njit(**_OPTIONS)
def scatter_forces(nodes, forces, scale, out):
    """Add scale[e, s] * forces[e, s] to the nodal vector `out` (n, 3)."""
    for e in range(nodes.shape[0]):
        for s in range(forces.shape[1]):
            for a in range(nodes.shape[1]):
                node = nodes[e, a]
                for i in range(3):
                    out[node, i] += scale[e, s] * forces[e, s, a, i]


@no_type_check
@numba.njit(**_OPTIONS)
def gather_dot(nodes, forces, x, out):
    """Fill out[e, s, :] = sum over the nodes of forces[e, s] * x, x of shape (n, 3, k)."""
    columns = x.shape[2]
    for e in range(nodes.shape[0]):
        for s in range(forces.shape[1]):
            if columns == 1:
                total = 0.0
                for a in range(nodes.shape[1]):
                    node = nodes[e, a]
                    for i in range(3):
                        total += forces[e, s, a, i] * x[node, i, 0]
                out[e, s, 0] = total
                continue
            for c in range(columns):
                out[e, s, c] = 0.0
            for a in range(nodes.shape[1]):
                node = nodes[e, a]
                for i in range(3):
                    f = forces[e, s, a, i]
                    for c in range(columns):
                        out[e, s, c] += f * x[node, i, c]


@no_type_check
@numba.njit(**_OPTIONS)
def tangent(
    gradients, F, cofactors, invariants, coefficients, weights, volumes, mean, slots, values
):
    """Add the element tangents to the stored entries `values` of the symmetric matrix.

    Sizes of m elements with q quadrature points and k nodes:

    - coefficients: d1, d2, dj, d11, d12, d1j, d22, d2j, djj per unit modulus, (9, m, q);
    - weights: modulus times volume of the quadrature points, (m, q);
    - volumes: volume of the quadrature points, (m, q);
    - mean: mean modulus times U'' over volume where the volumetric energy is averaged, (m,), or
      empty;
    - slots: index in `values` of each entry of the upper triangle, by blocks of node pairs,
      (m, 3k(3k+1)/2).
    """
    k = gradients.shape[2]
    B = np.empty((3, 3))
    p = np.empty((k, 3))
    t = np.zeros((k, 3))
    c = np.empty((k, 3))
    yp = np.zeros((k, 3))
    yt = np.zeros((k, 3))
    yc = np.empty((k, 3))
    block = np.empty((3, 3))
    average = np.zeros((k, 3))
    for e in range(gradients.shape[0]):
        if mean.shape[0] > 0:
            average[:] = 0.0
        for q in range(gradients.shape[1]):
            M = F[e, q]
            cof = cofactors[e, q]
            g = gradients[e, q]
            w = weights[e, q]
            d1 = w * coefficients[0, e, q]
            d2 = w * coefficients[1, e, q]
            dj = w * coefficients[2, e, q]
            d11 = w * coefficients[3, e, q]
            d12 = w * coefficients[4, e, q]
            d1j = w * coefficients[5, e, q]
            d22 = w * coefficients[6, e, q]
            d2j = w * coefficients[7, e, q]
            djj = w * coefficients[8, e, q]
            i1 = invariants[0, e, q]
            second = d2 != 0.0 or d22 != 0.0
            first = second or d11 != 0.0 or d1j != 0.0
            for a in range(k):
                for i in range(3):
                    p[a, i] = 2.0 * (M[i, 0] * g[a, 0] + M[i, 1] * g[a, 1] + M[i, 2] * g[a, 2])
                    c[a, i] = cof[i, 0] * g[a, 0] + cof[i, 1] * g[a, 1] + cof[i, 2] * g[a, 2]
                    yc[a, i] = djj * c[a, i]
            if second:
                for i in range(3):
                    for j in range(3):
                        B[i, j] = M[i, 0] * M[j, 0] + M[i, 1] * M[j, 1] + M[i, 2] * M[j, 2]
                for a in range(k):
                    for i in range(3):
                        t[a, i] = (
                            i1 * p[a, i] - B[i, 0] * p[a, 0] - B[i, 1] * p[a, 1] - B[i, 2] * p[a, 2]
                        )
            if first:
                for a in range(k):
                    for i in range(3):
                        yp[a, i] = d11 * p[a, i] + d12 * t[a, i] + d1j * c[a, i]
                        yt[a, i] = d12 * p[a, i] + d22 * t[a, i] + d2j * c[a, i]
                        yc[a, i] += d1j * p[a, i] + d2j * t[a, i]
            if mean.shape[0] > 0:
                for a in range(k):
                    for i in range(3):
                        average[a, i] += volumes[e, q] * c[a, i]
            entry = 0
            for a in range(k):
                for b in range(a, k):
                    dot = g[a, 0] * g[b, 0] + g[a, 1] * g[b, 1] + g[a, 2] * g[b, 2]
                    # d2J/dF2: F times the cross product of the gradients
                    x0 = g[a, 1] * g[b, 2] - g[a, 2] * g[b, 1]
                    x1 = g[a, 2] * g[b, 0] - g[a, 0] * g[b, 2]
                    x2 = g[a, 0] * g[b, 1] - g[a, 1] * g[b, 0]
                    z0 = dj * (M[0, 0] * x0 + M[0, 1] * x1 + M[0, 2] * x2)
                    z1 = dj * (M[1, 0] * x0 + M[1, 1] * x1 + M[1, 2] * x2)
                    z2 = dj * (M[2, 0] * x0 + M[2, 1] * x1 + M[2, 2] * x2)
                    for i in range(3):
                        for j in range(3):
                            block[i, j] = c[a, i] * yc[b, j]
                    if first:
                        for i in range(3):
                            for j in range(3):
                                block[i, j] += p[a, i] * yp[b, j] + t[a, i] * yt[b, j]
                    diagonal = 2.0 * d1 * dot
                    if second:
                        half = (p[a, 0] * p[b, 0] + p[a, 1] * p[b, 1] + p[a, 2] * p[b, 2]) * 0.25
                        diagonal += 2.0 * d2 * (i1 * dot - half)
                        for i in range(3):
                            for j in range(3):
                                block[i, j] += d2 * (
                                    p[a, i] * p[b, j]
                                    - 0.5 * p[b, i] * p[a, j]
                                    - 2.0 * B[i, j] * dot
                                )
                    block[0, 0] += diagonal
                    block[1, 1] += diagonal
                    block[2, 2] += diagonal
                    block[0, 1] += z2
                    block[0, 2] -= z1
                    block[1, 0] -= z2
                    block[1, 2] += z0
                    block[2, 0] += z1
                    block[2, 1] -= z0
                    if a == b:
                        for i in range(3):
                            for j in range(i, 3):
                                values[slots[e, entry]] += block[i, j]
                                entry += 1
                    else:
                        for i in range(3):
                            for j in range(3):
                                values[slots[e, entry]] += block[i, j]
                                entry += 1
        if mean.shape[0] > 0:
            entry = 0
            for a in range(k):
                for b in range(a, k):
                    for i in range(3):
                        for j in range(i if a == b else 0, 3):
                            values[slots[e, entry]] += mean[e] * average[a, i] * average[b, j]
                            entry += 1


@no_type_check
@numba.njit(**_OPTIONS)
def strain_energies(nodes, gradients, weights, lame, shear, fields, out):
    """Add to `out` (pairs, m s, cases) products of the small strains of fields in pairs.

    A product is the integral of lame tr(a) tr(b) + 2 shear a : b over an element (s = 1), or the
    part of each quadrature point (s = q). `fields` (n, 3, k, cases) are k fields of each case; the
    pairs are (0, 0), (0, 1), ..., (1, 1), ... of these. The innermost loops are over the cases.
    """
    count, cases = fields.shape[2], fields.shape[3]
    points = gradients.shape[1]
    sites = out.shape[1] // gradients.shape[0]
    strains = np.empty((count, 6, cases), dtype=np.float32)
    for e in range(gradients.shape[0]):
        for q in range(points):
            row = e * sites + min(q, sites - 1)
            strains[:] = 0.0
            for a in range(gradients.shape[2]):
                node = nodes[e, a]
                gx = np.float32(gradients[e, q, a, 0])
                gy = np.float32(gradients[e, q, a, 1])
                gz = np.float32(gradients[e, q, a, 2])
                for k in range(count):
                    u = fields[node, 0, k]
                    v = fields[node, 1, k]
                    w = fields[node, 2, k]
                    strain = strains[k]
                    for c in range(cases):
                        strain[0, c] += u[c] * gx
                        strain[1, c] += v[c] * gy
                        strain[2, c] += w[c] * gz
                        strain[3, c] += u[c] * gy + v[c] * gx
                        strain[4, c] += v[c] * gz + w[c] * gy
                        strain[5, c] += w[c] * gx + u[c] * gz
            one = np.float32(weights[e, q] * lame[e])
            two = np.float32(weights[e, q] * shear[e])
            p = 0
            for k in range(count):
                a = strains[k]
                for j in range(k, count):
                    b = strains[j]
                    target = out[p, row]
                    for c in range(cases):
                        volume = (a[0, c] + a[1, c] + a[2, c]) * (b[0, c] + b[1, c] + b[2, c])
                        normal = a[0, c] * b[0, c] + a[1, c] * b[1, c] + a[2, c] * b[2, c]
                        sheared = a[3, c] * b[3, c] + a[4, c] * b[4, c] + a[5, c] * b[5, c]
                        target[c] += one * volume + two * (normal + normal + sheared)
                    p += 1
